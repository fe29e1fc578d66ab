"""Report of a benchmark: summary, key numbers, example scenes, then all details.

It depends only on its arguments: same results, same bytes. :func:`with_times` adds the costs of a
run afterwards: a section, and the seconds among the key numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from slgaussian.benchmark.attribution import STAND_INS
from slgaussian.benchmark.costs import Times
from slgaussian.benchmark.reports import examples
from slgaussian.benchmark.reports.model import (
    Block,
    Card,
    Cards,
    Column,
    Fold,
    Line,
    Prose,
    Report,
    Section,
    Slot,
    Table,
    Terms,
    blocks_as,
    escape,
    number,
)
from slgaussian.benchmark.reports.paper_tables import paper_section
from slgaussian.benchmark.reports.score_tables import (
    METRICS,
    SCORES,
    fold_protocols,
    method_tables,
    metrics_table,
    scores_of,
)
from slgaussian.benchmark.reports.speed import speed_blocks
from slgaussian.benchmark.reports.summary import COSTS, key_costs, summarize
from slgaussian.benchmark.scores import (
    GOOD,
    grouped,
    key_of,
    of_first_protocol,
    score_table,
)

Row = Mapping[str, Any]

PICTURED = 24
"""Largest number of scenes with pictures, those with the worst answers; all are in the tables."""

LISTED = 3
"""Largest number of scenes listed by name for one reason of being left out."""

TIMES = "<!-- times -->"
"""Placeholder of the section of :func:`with_times`."""


def run_report(
    scenes: Sequence[examples.Scene],
    manifest: Mapping[str, Any],
    failures: Sequence[Mapping[str, str]] = (),
    attribution: Sequence[Row] = (),
) -> Report:
    """Make the report of a run.

    Args:
        scenes: sequence of slgaussian.benchmark.reports.examples.Scene
        manifest: Versions, settings and data, nested mappings allowed. Entries of ``data``, by
            scene, have ``format``, ``scene`` and ``published``, whether it is a scene of the
            paper's tables, and ``cameras``, the source of the cameras.
        failures: sequence of mapping. Scenes left out: ``scene``, ``stage``, ``reason`` (the
            columns of ``failures.parquet``).
        attribution: sequence of mapping. Rows of the spec ``attribution``: cause of each miss of
            our method.
    """
    rows = [row for scene in scenes for row in scene.rows]
    methods = list(dict.fromkeys(row["method"] for row in rows))
    ours = next(iter(methods), "")
    leading = of_first_protocol(rows)
    answers = [row for row in leading if row["method"] == ours]
    scores = score_table(rows).to_pylist()
    leading_scores = [s for s in scores if s["protocol"] == leading[0]["protocol"]]
    lost_by = {key_of(row): row["lost"] or "" for row in attribution}
    data = manifest.get("data", {})
    sections, worst, scene_folds = _picture_sections(scenes, answers, lost_by)
    if leading_scores:
        sections.append(_scores_section(rows, methods))
    if failures:
        sections.append(_failures_section(failures))
    sections.append(Section("Speed and accuracy", [Slot(TIMES)], "times", link="Speed"))
    if worst:
        sections.append(_worst_section(answers, worst, attribution))
    if (paper := paper_section(rows, data, ours)) is not None:
        sections.append(paper)
    if scenes:
        our_scores = [score for score in leading_scores if score["method"] == ours]
        blocks = [*_scene_tables(scenes, our_scores, data), *scene_folds]
        sections.append(Section("Scenes", blocks, "scenes", link="Scenes"))
    configuration = [
        Fold("Settings, methods and versions", [Table.of_values({**manifest, "data": {}})])
    ]
    if data:
        configuration.append(Fold("Data of each scene, with digests", [Table.of_values(data)]))
    sections.append(Section("Configuration", configuration, "configuration", link="Configuration"))
    summary = summarize(scenes, methods, answers, leading_scores, manifest, len(failures))
    return Report("SLGaussian report", summary, sections)


def with_times(
    pages: Mapping[str, str],
    times: Times,
    rows: Sequence[Row] = (),
    novel: Sequence[tuple[str, str, float]] = (),
) -> dict[str, str]:
    """Complete a report of :func:`run_report` with the costs of one run on one machine.

    ``pages`` are its forms ``html`` and ``markdown``; for other arguments see
    :func:`slgaussian.benchmark.reports.speed.speed_blocks`.
    """
    costs, blocks = [key_costs(times.costs)], speed_blocks(times, rows, novel)
    complete = {}
    for name, form in (("html", "html"), ("markdown", "md")):
        page = pages[name].replace(TIMES, blocks_as(form, blocks))
        complete[name] = page.replace(COSTS, f"{COSTS}\n{blocks_as(form, costs)}\n{COSTS}")
    return complete


def _picture_sections(
    scenes: Sequence[examples.Scene], answers: Sequence[Row], lost_by: Mapping[examples.Key, str]
) -> tuple[list[Section], list[Card], list[Fold]]:
    """Make the section of the example scene, the worst answers, and the pictures of all scenes.

    The pictures of one scene are in memory at a time.
    """
    worst = examples.limit_per_scene(examples.sort_worst_first(answers), examples.WORST)
    cards: dict[examples.Key, Card] = {}
    worst_first = sorted(scenes, key=lambda scene: scene.metrics.get("iou", 1.0))
    pictured = {scene.name for scene in worst_first[:PICTURED]}
    example, reason = examples.choose_example(scenes) if scenes else (None, "")
    sections, scene_folds = [], []
    for place, scene in enumerate(scenes):
        rows = [row for row in answers if row["scene"] == scene.name]
        chosen = [row for row in worst if row["scene"] == scene.name]
        has_pictures = scene.name in pictured or scene is example or chosen
        images = scene.pictures() if has_pictures else {}
        if scene is example:
            sections = [examples.example_section(scene, reason, rows, images, lost_by)]
        for row in chosen:
            cards[key_of(row)] = examples.answer_card(row, images, lost_by.get(key_of(row), ""))
        images = images if scene.name in pictured else {}
        scene_folds.append(examples.scene_fold(scene, f"scene-{place}", rows, images))
    return sections, [cards[key_of(row)] for row in worst], scene_folds


def _scores_section(rows: Sequence[Row], methods: Sequence[str]) -> Section:
    """Return the scores of all methods; tables of other protocols than the first are collapsed."""
    terms = {score.title: score.help for score in scores_of(rows[0]["protocol"])} | {
        "near-best": "selection of all objects whose score above the canonical phrases is at least "
        "the given share of the best object's"
    }
    explanations: list[Block] = [Terms(terms)]
    if methods[1:]:
        note = "Methods are sorted by the first column; the best value of a column is bold. A "
        note += "method called “like” is not the original program: it reimplements the main idea "
        note += "on the same photographs, Gaussians and encoder."
        explanations.append(Prose(note))
    tables = method_tables(rows, methods[0] if methods[1:] else "")
    return Section("Scores", fold_protocols(tables, explanations), "scores", link="Scores")


def _failures_section(failures: Sequence[Mapping[str, str]]) -> Section:
    """List the scenes that were left out, one line per reason."""
    rows = []
    for (stage, reason), members in grouped(failures, "stage", "reason").items():
        names = [failure["scene"] for failure in members]
        rest = [f"and {len(names) - LISTED} more"] if names[LISTED:] else []
        rows.append(["; ".join([*names[:LISTED], *rest]), stage, reason])
    heads = [Column(name, is_text=True) for name in ("Scene", "Stage", "Reason")]
    return Section("Left out", [Table.of(heads, rows)], "left-out", link="Left out", style="failed")


def _worst_section(
    answers: Sequence[Row], worst: Sequence[Card], attribution: Sequence[Row]
) -> Section:
    """Show the answers with the lowest scores, and the causes of misses."""
    blocks: list[Block] = []
    scored = [row for row in answers if row["iou"] is not None]
    for (dataset,), rows in grouped(scored, "dataset").items():
        low = {key_of(row) for row in rows if row["iou"] < GOOD}
        outside = {key_of(row) for row in rows if not row["hit_mask"]}
        text = f"**{escape(dataset)}**: {len(low | outside)} misses in {len(rows)} queries: "
        text += f"{len(low)} with an IoU below {GOOD}, {len(outside)} with a point outside the "
        text += "labelled mask."
        blocks.append(Prose(text))
    protocol = escape(answers[0]["protocol"])
    blocks += [Prose(f"The lowest scores, a few per scene, by {protocol}:"), Cards(worst)]
    if attribution:
        blocks += _attribution_blocks(attribution)
    return Section("Lowest scores", blocks, "worst", link="Lowest scores")


def _attribution_blocks(attribution: Sequence[Row]) -> list[Block]:
    """List the causes of misses of each data set, and of all queries in the last line."""
    columns = [Column("Responsible stage", is_text=True), Column("Queries")]
    columns += [Column(title, help) for title, help in STAND_INS.values()]
    blocks: list[Block] = []
    for (dataset,), queries in grouped(attribution, "dataset").items():
        by_stage = {stage or "no miss": rows for (stage,), rows in grouped(queries, "lost").items()}
        order = sorted(by_stage, key=lambda stage: (stage == "no miss", -len(by_stage[stage])))
        lines = []
        for stage in [*order, "all"]:
            rows = by_stage.get(stage, queries)
            ious = ([row[n] for row in rows if row[n] is not None] for n in STAND_INS)
            means = [number(float(np.mean(values)), 3) if values else None for values in ious]
            style = "mean" if stage == "all" else ""
            lines.append(Line.of([stage, str(len(rows)), *means], style=style))
        blocks.append(Table.of(columns, lines, f"Misses by responsible stage, {dataset}"))
    text = "Mean IoU if stages are replaced by ground truth one after the other, from left to "
    text += "right. The first replacement that turns a miss into a hit names the responsible stage."
    terms = {title: help for title, help in STAND_INS.values() if help}
    return [*blocks, Prose(text), Terms(terms)]


def _scene_tables(
    scenes: Sequence[examples.Scene], scores: Sequence[Row], data: Mapping[str, Any]
) -> list[Block]:
    """List the metrics of all scenes; ``scores`` are those of our method, first protocol."""
    blocks: list[Block] = []
    links = {scene.name: f"scene-{place}" for place, scene in enumerate(scenes)}
    for dataset in dict.fromkeys(scene.dataset for scene in scenes):
        metrics = {scene.name: scene.metrics for scene in scenes if scene.dataset == dataset}
        of_set = [score for score in scores if score["dataset"] == dataset]
        blocks.append(metrics_table(metrics, of_set, dataset, links))
    present = {name for scene in scenes for name in scene.metrics}
    view_metrics = [m for m in METRICS if m.metric in present and m not in SCORES["slgaussian"]]
    blocks.append(Terms({m.title: m.help for m in view_metrics}))
    estimated = []
    for name, of in data.items():
        if (cameras := of.get("cameras", "given")) != "given":
            left_out = ", ".join(of.get("left_out", {}))
            note = f"; not registered: {left_out}" if left_out else ""
            estimated.append(f"{escape(name)} ({escape(cameras + note)})")
    if estimated:
        blocks.append(Prose(f"Estimated cameras: {', '.join(estimated)}."))
    return blocks
