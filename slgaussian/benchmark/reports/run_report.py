"""Report of a benchmark: summary, key numbers, an example scene, then all details.

It depends only on its arguments: same results, same bytes. :func:`with_times` appends the section
of costs afterwards.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from slgaussian.benchmark.attribution import REPLACEMENTS
from slgaussian.benchmark.baselines import ROWS, is_variant
from slgaussian.benchmark.costs import Times
from slgaussian.benchmark.evaluate import NOT_UNDERSTOOD
from slgaussian.benchmark.reports import examples, model
from slgaussian.benchmark.reports.paper_tables import paper_section
from slgaussian.benchmark.reports.score_tables import (
    METRICS,
    SCORES,
    fold_protocols,
    mean_cells,
    method_tables,
    metrics_table,
    protocol_scores,
)
from slgaussian.benchmark.reports.speed import speed_blocks
from slgaussian.benchmark.scores import GOOD_IOU, Rows, group_rows, query_key, score_table

Row = Mapping[str, Any]
BySet = Mapping[str, tuple[Mapping[str, Mapping[str, float]], Sequence[Row]]]
"""Metrics by scene, and scores, of each data set."""

MAX_PICTURED_SCENES = 24
"""Largest number of scenes with pictures, those with the worst answers; all are in the tables."""

MAX_WORST_ANSWERS, MAX_WORST_PER_SCENE = 8, 2
"""Number of answers with the lowest scores that are shown, and the maximum per scene of many."""

MAX_LISTED = 3
"""Largest number of scenes listed by name for one reason of being left out."""

CARD_TERMS = model.terms(
    {
        "prediction": "predicted mask, in colour and outlined in cyan; the label is outlined in "
        "yellow",
        "relevancy": "stretched to its range in the picture, 0 to 1",
        "dot, point": "predicted point; ✓ inside the labelled mask, ✗ outside",
    }
)


def run_report(
    scenes: Sequence[examples.Scene],
    rows: Rows,
    manifest: Mapping[str, Any],
    failures: Sequence[Mapping[str, str]] = (),
    attribution: Rows | None = None,
) -> model.Report:
    """Make the report of a run.

    Args:
        rows: Rows of the spec ``samples`` of all scenes, our method first.
        manifest: Versions, settings and data, nested mappings allowed. Entries of ``data``, by
            scene, have ``format``, ``scene`` and ``published``, whether it is a scene of the
            paper's tables, and ``cameras``, the source of the cameras.
        failures: Scenes left out: ``scene``, ``stage``, ``reason``.
        attribution: Rows of the spec ``attribution``: cause of each miss of our method.
    """
    lost = Rows.join([] if attribution is None else [attribution], "attribution")
    methods = rows.values("method")
    ours = next(iter(methods), "")
    answers = rows.leading.where(method=ours)
    scores = score_table(rows.leading).to_pylist()
    data = manifest.get("data", {})
    sections, worst, folds = _picture_sections(scenes, answers, lost)
    if scores:
        sections.append(_scores_section(rows, methods))
    if failures:
        sections.append(_failures_section(failures))
    if worst:
        sections.append(_worst_section(answers, worst, lost))
    if (paper := paper_section(rows, data, ours)) is not None:
        sections.append(paper)
    summary: list[model.Block] = [
        model.Prose(f"No scene was completed; {len(failures)} left out.", "lead")
    ]
    if scenes:
        by_set = {
            dataset: (
                {scene.name: scene.metrics for scene in scenes if scene.dataset == dataset},
                [score for score in scores if score["dataset"] == dataset],
            )
            for dataset in dict.fromkeys(scene.dataset for scene in scenes)
        }
        sections.append(model.Section("Scenes", _scene_blocks(by_set, ours, data, folds), "scenes"))
        summary = _summary(scenes, methods, answers, data, len(failures))
        summary += _key_scores(by_set, ours)
    configuration = [
        model.Fold("Settings, methods and versions", [model.values_table({**manifest, "data": {}})])
    ]
    if data:
        configuration.append(
            model.Fold("Data of each scene, with digests", [model.values_table(data)])
        )
    sections.append(model.Section("Configuration", configuration, "configuration"))
    sections.append(_repeat_section(manifest))
    return model.Report("SLGaussian report", summary, sections)


def _repeat_section(manifest: Mapping[str, Any]) -> model.Section:
    """Give the command that repeats the run, and describe what it compares first."""
    digests = set(manifest.get("weights", {}).values())
    for data in manifest.get("data", {}).values():
        digests |= {*data.get("files", {}).values(), *data.get("labels", {}).values()}
    files = model.count_text(len(digests), "file") if digests else "no file, as none was read"
    text = "`slgaussian run run.toml -o again`, in the folder of this report, repeats the run. "
    text += "The file `run.toml` has all settings and scenes, and under `[inputs]` the SHA-256 of "
    text += f"{files}; a file that differs is refused by name. Other versions than slgaussian "
    text += f"{manifest.get('slgaussian', '')}, commit {manifest.get('commit', '')}, and other "
    text += "processors, whose last digits differ, give a warning. Seconds and memory will differ."
    return model.Section("Repeat this", [model.Prose(text)], "repeat")


def with_times(
    pages: Mapping[str, str],
    times: Times,
    rows: Rows,
    novel: Sequence[tuple[str, str, float]] = (),
) -> dict[str, str]:
    """Append the costs of one run to the forms ``html`` and ``md`` of its report.

    For other arguments see :func:`slgaussian.benchmark.reports.speed.speed_blocks`.
    """
    section = model.Section("Speed and accuracy", speed_blocks(times, rows, novel), "times")
    return {form: model.append_section(page, form, section) for form, page in pages.items()}


def _summary(
    scenes: Sequence[examples.Scene],
    methods: Sequence[str],
    answers: Rows,
    data: Mapping[str, Any],
    left_out: int,
) -> list[model.Block]:
    """Summarise a run in sentences; ``answers`` are those of our method, the first."""
    sizes = sorted({len(scene["context"]) for scene in data.values() if "context" in scene})
    names = dict.fromkeys(s.name if len(scenes) == 1 else s.dataset for s in scenes)
    text = f"Semantic fields of {model.count_text(len(scenes), 'scene')} "
    text += f"({', '.join(map(model.escape, names))})"
    if sizes:
        text += f", built from {' to '.join(map(str, dict.fromkeys((sizes[0], sizes[-1]))))} "
        text += f"photographs{' each' if len(scenes) > 1 else ''}"
    scored = sum(row["iou"] is not None for row in answers)
    text += f". {model.count_text(scored or len(answers), 'query', 'queries')} "
    text += "scored" if scored else "without ground truth, not scored"
    variants = sum(map(is_variant, methods[1:]))
    counts = {"baseline": len(methods) - 1 - variants, "variant": variants}
    if compared := [model.count_text(n, kind) for kind, n in counts.items() if n]:
        text += f", compared with {' and '.join(compared)}"
    unknown = sum(row["note"].startswith(NOT_UNDERSTOOD) for row in answers)
    exceptions = {
        f"[Scenes left out](#left-out): {left_out}.": left_out,
        f"Other queries, without ground truth: {len(answers) - scored}.": 0 < scored < len(answers),
        f"Queries that the encoder does not understand (IoU 0): {unknown}.": unknown,
    }
    listed = " ".join(part for part, holds in exceptions.items() if holds)
    return [model.Prose(f"{text}.", "lead"), model.Prose(listed, "soft fine")]


def _key_scores(by_set: BySet, ours: str) -> list[model.Table]:
    """Return the main scores of our method and of the best baseline, a row per data set."""
    present = {name for metrics, _ in by_set.values() for of in metrics.values() for name in of}
    columns = [m for m in METRICS if m.metric in present & {"iou", "hit_mask", "psnr"}]
    lines: list[list[model.Cell | str]] = []
    for dataset, (metrics, scores) in by_set.items():
        cells = mean_cells(metrics, [s for s in scores if s["method"] == ours], columns)
        rivals = [s for s in scores if s["method"] != ours and not is_variant(s["method"])]
        for place, column in enumerate(columns):
            parts = [cells[place].below] if cells[place].below else []
            values = [(s["value"], s["method"]) for s in rivals if s["metric"] == column.metric]
            if values:
                value, method = max(values)
                parts.append(f"best baseline: {value:.{column.digits}f}, {method}")
            cells[place] = replace(cells[place], below="; ".join(parts))
        lines.append([dataset, *cells])
    heads = ["Data set", *(column.column for column in columns)]
    return [model.Table(heads, lines, style="key")] if columns else []


def _picture_sections(
    scenes: Sequence[examples.Scene], answers: Rows, attribution: Rows
) -> tuple[list[model.Section], list[model.Card], dict[str, model.Fold]]:
    """Make the section of the example scene, the worst answers, and the pictures by scene.

    The pictures of one scene are in memory at a time.
    """
    per_scene = max(MAX_WORST_PER_SCENE, -(-MAX_WORST_ANSWERS // (len(scenes) or 1)))
    worst = examples.worst_answers(answers, MAX_WORST_ANSWERS, per_scene)
    shown = set(map(query_key, worst))
    lost_by = {key: row["lost"] or "" for row in attribution if (key := query_key(row)) in shown}
    cards: dict[examples.Key, model.Card] = {}
    worst_first = sorted(scenes, key=lambda scene: scene.metrics.get("iou", 1.0))
    pictured = {scene.name for scene in worst_first[:MAX_PICTURED_SCENES]}
    example = examples.choose_example(scenes) if scenes else None
    sections, folds = [], {}
    for place, scene in enumerate(scenes):
        chosen = [row for row in worst if row["scene"] == scene.name]
        if not (chosen or scene is example or scene.name in pictured):
            continue
        images = scene.pictures()
        if scene is example:
            of_scene = list(answers.where(scene=scene.name))
            sections = [examples.example_section(scene, of_scene, images)]
        for row in chosen:
            cards[query_key(row)] = examples.answer_card(
                row, images, lost_by.get(query_key(row), "")
            )
        if images and scene.name in pictured:
            folds[scene.name] = examples.scene_fold(scene, f"scene-{place}", images)
    return sections, [cards[query_key(row)] for row in worst], folds


def _scores_section(rows: Rows, methods: Sequence[str]) -> model.Section:
    """Return the scores of all methods; tables of other protocols than the first are collapsed."""
    explanations: list[model.Block] = [
        model.terms({s.title: s.help for s in protocol_scores(rows[0]["protocol"])})
    ]
    if methods[1:]:
        note = "Methods are sorted by the first column; the best value of a column is bold. A "
        note += "method called “like” is not the original program: it reimplements the main idea "
        note += "on the same photographs, Gaussians and encoder."
        abouts = {name: ROWS[name].about for name in methods if name in ROWS}
        explanations += [model.Prose(note), model.terms(abouts)]
    tables = method_tables(rows, methods[0] if methods[1:] else "")
    return model.Section("Scores", fold_protocols(tables, explanations), "scores")


def _failures_section(failures: Sequence[Mapping[str, str]]) -> model.Section:
    """List the scenes that were left out, one row per reason."""
    rows = []
    for (stage, reason), members in group_rows(failures, "stage", "reason").items():
        names = [failure["scene"] for failure in members]
        rest = [f"and {len(names) - MAX_LISTED} more"] if names[MAX_LISTED:] else []
        rows.append(["; ".join([*names[:MAX_LISTED], *rest]), stage, reason])
    heads = [model.Column(name, is_text=True) for name in ("Scene", "Stage", "Reason")]
    return model.Section("Left out", [model.Table(heads, rows)], "left-out", style="failed")


def _worst_section(answers: Rows, worst: Sequence[model.Card], attribution: Rows) -> model.Section:
    """Show the answers with the lowest scores, and the causes of misses."""
    blocks: list[model.Block] = []
    scored = answers.having("iou")
    for dataset in scored.values("dataset"):
        rows = scored.where(dataset=dataset)
        misses = sum(row["iou"] < GOOD_IOU or not row["hit_mask"] for row in rows)
        text = f"**{model.escape(dataset)}**: {misses} misses in {len(rows)} queries, by an IoU "
        blocks.append(model.Prose(f"{text}below {GOOD_IOU} or a point outside the labelled mask."))
    blocks += [CARD_TERMS, model.Cards(worst)]
    if attribution:
        blocks += _attribution_blocks(attribution)
    return model.Section("Lowest scores" if scored else "Answers", blocks, "worst")


def _attribution_blocks(attribution: Rows) -> list[model.Block]:
    """List the causes of misses of each data set, and of all queries in the last row."""
    columns = [model.Column("Responsible stage", is_text=True), model.Column("Queries")]
    columns += [model.Column(title, help) for title, help in REPLACEMENTS.values()]
    blocks: list[model.Block] = []
    for dataset in attribution.values("dataset"):
        by_stage: dict[str, list[list[float | None]]] = defaultdict(list)
        for row in attribution.where(dataset=dataset):
            for stage in (row["lost"] or "no miss", "all"):
                by_stage[stage].append([row[name] for name in REPLACEMENTS])
        lines = []
        order = sorted(by_stage, key=lambda stage: -len(by_stage[stage]))
        for stage in sorted(order, key=lambda stage: (stage == "all", stage == "no miss")):
            rows = by_stage[stage]
            ious = ([v for v in values if v is not None] for values in zip(*rows, strict=True))
            means = (model.number(float(np.mean(values)), 3) if values else None for values in ious)
            lines.append([stage, str(len(rows)), *means])
        title = f"Misses by responsible stage, {dataset}"
        blocks.append(model.Table(columns, lines, title, has_total=True))
    text = "Mean IoU if stages are replaced by ground truth one after the other, from left to "
    text += "right. The first replacement that turns a miss into a hit names the responsible stage."
    replacements = {title: help for title, help in REPLACEMENTS.values() if help}
    return [*blocks, model.Prose(text), model.terms(replacements)]


def _scene_blocks(
    by_set: BySet, ours: str, data: Mapping[str, Any], folds: Mapping[str, model.Fold]
) -> list[model.Block]:
    """List the metrics of all scenes and their pictures."""
    links = {name: fold.id for name, fold in folds.items()}
    blocks: list[model.Block] = [
        metrics_table(metrics, [s for s in scores if s["method"] == ours], dataset, links)
        for dataset, (metrics, scores) in by_set.items()
    ]
    present = {name for metrics, _ in by_set.values() for of in metrics.values() for name in of}
    view_metrics = [m for m in METRICS if m.metric in present and m not in SCORES["slgaussian"]]
    blocks.append(model.terms({m.title: m.help for m in view_metrics}))
    estimated = []
    for name, of in data.items():
        if (cameras := of.get("cameras", "given")) != "given":
            left_out = ", ".join(of.get("left_out", {}))
            note = f"; not registered: {left_out}" if left_out else ""
            estimated.append(f"{model.escape(name)} ({model.escape(cameras + note)})")
    if estimated:
        blocks.append(model.Prose(f"Estimated cameras: {', '.join(estimated)}."))
    return [*blocks, *folds.values()]
