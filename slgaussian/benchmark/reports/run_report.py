"""Report of a benchmark: a sentence, key numbers, example scenes, then all details.

It depends only on its arguments: same results, same bytes. :func:`with_times` adds the costs of a
run afterwards: a section, and the seconds among the key numbers.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from slgaussian.benchmark.attribution import STAND_INS
from slgaussian.benchmark.costs import Times
from slgaussian.benchmark.outputs import file_name, mask_place
from slgaussian.benchmark.reports import look
from slgaussian.benchmark.reports.model import (
    Block,
    Card,
    Cards,
    Column,
    Fold,
    Prose,
    Report,
    Section,
    Slot,
    Table,
    Terms,
    blocks_as,
    escape,
    flatten,
    line_of,
    number,
)
from slgaussian.benchmark.reports.paper_tables import paper_section
from slgaussian.benchmark.reports.score_tables import (
    conditions,
    method_tables,
    metrics_table,
    scores_of,
)
from slgaussian.benchmark.reports.speed import speed_blocks
from slgaussian.benchmark.reports.summary import COSTS, cost_numbers, summarize
from slgaussian.benchmark.scores import (
    GOOD,
    differences,
    grouped,
    key_of,
    of_first_protocol,
    score_table,
)
from slgaussian.datasets.published import Standing

Row = Mapping[str, Any]

PICTURED = 24
"""Largest number of scenes with pictures, those with the worst answers; all are in the tables."""

LEFT_OUT = 3
"""Largest number of scenes listed by name for one reason of being left out."""

TIMES = "<!-- times -->"
"""Placeholder of the section of :func:`with_times`."""


def run_report(
    scenes: Sequence[look.Scene],
    manifest: Mapping[str, Any],
    failures: Sequence[Mapping[str, str]] = (),
    attribution: Sequence[Row] = (),
) -> Report:
    """Make the report of a run.

    Parameters
    ----------
    scenes : sequence of slgaussian.benchmark.reports.look.Scene
    manifest : mapping
        Versions, settings and data, nested mappings allowed. Entries of ``data``, by scene, have
        ``published``, the fields of :class:`slgaussian.datasets.published.Standing`, and
        ``cameras``, the source of the cameras.
    failures : sequence of mapping
        Scenes left out: ``scene``, ``stage``, ``reason`` (the columns of ``failures.parquet``).
    attribution : sequence of mapping
        Rows of the spec ``attribution``: cause of each miss of our method.
    """
    rows = [row for scene in scenes for row in scene.rows]
    methods = list(dict.fromkeys(row["method"] for row in rows))
    ours = next(iter(methods), "")
    leading = of_first_protocol(rows)
    answers = [row for row in leading if row["method"] == ours]
    scores = score_table(rows).to_pylist()
    leading_scores = [s for s in scores if s["protocol"] == leading[0]["protocol"]]
    lost_by = {key_of(row): row["lost"] or "" for row in attribution}
    sections, worst, scene_sections = _draw(scenes, answers, lost_by)
    sections += map(_next_section, scenes[:1])
    if leading_scores:
        sections += _score_sections(leading, leading_scores, scores, methods)
    if failures:
        sections.append(_failures_section(failures))
    sections.append(Section("Speed against error", [Slot(TIMES)], "times", link="Speed"))
    if worst:
        sections.append(_worst_section(answers, worst, attribution))
    data = manifest.get("data", {})
    standing = {n: Standing(**of["published"]) for n, of in data.items() if of.get("published")}
    if (paper := paper_section(rows, standing, ours)) is not None:
        sections.append(paper)
    if scenes:
        our_scores = [score for score in leading_scores if score["method"] == ours]
        sections.append(_scenes_section(scenes, our_scores, data))
    sections += [*scene_sections, _manifest_section(manifest)]
    summary = summarize(scenes, methods, answers, leading_scores, manifest, len(failures))
    return Report("SLGaussian report", summary, sections)


def with_times(
    pages: Mapping[str, str],
    times: Times,
    rows: Sequence[Row] = (),
    novel: Sequence[tuple[str, str, float]] = (),
) -> dict[str, str]:
    """Complete a report of :func:`run_report` with the costs of one run on one machine.

    Parameters
    ----------
    pages : {form: text}
        The forms ``html`` and ``markdown`` of the report.
    times, rows, novel
        See :func:`slgaussian.benchmark.reports.speed.speed_blocks`.
    """
    blocks = speed_blocks(times, rows, novel)
    costs = COSTS + blocks_as("html", [cost_numbers(times.costs)]) + COSTS
    return {
        "html": pages["html"].replace(COSTS, costs).replace(TIMES, blocks_as("html", blocks)),
        "markdown": pages["markdown"].replace(TIMES, blocks_as("md", blocks)),
    }


def _draw(
    scenes: Sequence[look.Scene], answers: Sequence[Row], lost_by: Mapping[look.Key, str]
) -> tuple[list[Section], list[tuple[Row, Card]], list[Section]]:
    """Make the sections of example scenes, the worst answers, and the sections of all scenes.

    The pictures of one scene are in memory at a time.
    """
    worst = look.limit_per_scene(look.sort_worst_first(answers), look.WORST)
    cards: dict[look.Key, Card] = {}
    reasons = look.choose_scenes((scene.name, scene.dataset, scene.metrics) for scene in scenes)
    worst_first = sorted(scenes, key=lambda scene: scene.metrics.get("iou", 1.0))
    pictured = {scene.name for scene in worst_first[:PICTURED]}
    looks, sections = [], []
    for place, scene in enumerate(scenes):
        rows = [row for row in answers if row["scene"] == scene.name]
        chosen = [row for row in worst if row["scene"] == scene.name]
        is_drawn = scene.name in pictured | reasons.keys() or chosen
        images = scene.pictures() if is_drawn else {}
        if scene.name in reasons:
            looks.append(look.look_section(scene, reasons[scene.name], rows, images, lost_by))
        for row in chosen:
            lost = lost_by.get(key_of(row), "")
            cards[key_of(row)] = look.answer_card(row, images, look.ANSWER, lost)
        images = images if scene.name in pictured else {}
        sections.append(look.scene_section(scene, f"scene-{place}", rows, images))
    if looks:
        looks[0] = replace(looks[0], id="look", link="Look")
    return looks, [(row, cards[key_of(row)]) for row in worst], sections


def _score_sections(
    leading: Sequence[Row],
    leading_scores: Sequence[Row],
    scores: Sequence[Row],
    methods: Sequence[str],
) -> Iterator[Section]:
    """Yield a table per data set for the first protocol, and the others folded below."""
    ours, *rivals = methods
    columns = scores_of(leading[0]["protocol"])
    by_method = {method: rows for (method,), rows in grouped(leading, "method").items()}
    gains = {
        (difference.dataset, method): difference
        for method in rivals
        for difference in differences(by_method[ours], by_method.get(method, []))
        if difference.metric == columns[0].metric
    }
    tables = method_tables(leading_scores, gains, ours if rivals else "")
    blocks: list[Block] = [*tables]
    terms = {score.title: score.help for score in columns} | {
        "near-best": "all objects that lead the canonical phrases by the given share of the best "
        "one's lead"
    }
    blocks.append(Terms(terms))
    if rivals:
        note = "Best IoU first; the best of each column is bold. What is called “like” is not the "
        note += "original, but what it is known for on the same photographs, Gaussians and encoder."
        blocks.append(Prose(note))
    title = "How good, by method" if rivals else "How good"
    yield Section(title, blocks, "scores", link="Scores")
    rest = [score for score in scores if score["protocol"] != leading[0]["protocol"]]
    if rest:
        yield Section("By other protocols", method_tables(rest), is_folded=True)


def _failures_section(failures: Sequence[Mapping[str, str]]) -> Section:
    """List the scenes that were left out, one line per reason."""
    scenes: dict[tuple[str, str], list[str]] = {}
    for failure in failures:
        scenes.setdefault((failure["stage"], failure["reason"]), []).append(failure["scene"])
    rows = []
    for (stage, reason), names in scenes.items():
        rest = len(names) - LEFT_OUT
        listed = "; ".join(names[:LEFT_OUT]) + (f"; and {rest} more" if rest > 0 else "")
        rows.append([listed, stage, reason])
    heads = [Column(name, is_text=True) for name in ("Scene", "Stage", "Reason")]
    return Section("Left out", [Table.of(heads, rows)], "left-out", link="Left out", style="failed")


def _worst_section(
    answers: Sequence[Row], worst: Sequence[tuple[Row, Card]], attribution: Sequence[Row]
) -> Section:
    """Show the answers with the lowest scores, and the causes of misses."""
    blocks: list[Block] = []
    scored = [row for row in answers if row["iou"] is not None]
    for (dataset,), rows in grouped(scored, "dataset").items():
        low = {key_of(row) for row in rows if row["iou"] < GOOD}
        beside = {key_of(row) for row in rows if not row["hit_mask"]}
        text = f"**{escape(dataset)}**: {len(low | beside)} of {len(rows)} queries are "
        text += f"missed, {len(low)} with an IoU below {GOOD} and {len(beside)} with a point "
        blocks.append(Prose(f"{text}beside the object."))
    protocol = f"{escape(answers[0]['protocol'])} ({escape(conditions(answers[0]))})"
    blocks.append(Prose(f"Here are the lowest, a few of a scene, by {protocol}."))
    blocks += [look.ANSWER_TERMS, Cards([card for _, card in worst])]
    rows = [
        [
            row["query"],
            f"{row['scene']}, {row['frame']}",
            number(row["iou"], 3),
            f"predictions/{mask_place(row).as_posix()}",
        ]
        for row, _ in worst
    ]
    place, mask = (Column(name, is_text=True) for name in ("Scene and frame", "Mask"))
    blocks.append(Fold("Where their masks are", [Table.of(["Query", place, "IoU", mask], rows)]))
    if attribution:
        blocks += _attribution_blocks(attribution)
    return Section("Answered worst", blocks, "worst", link="Worst answers")


def _attribution_blocks(attribution: Sequence[Row]) -> list[Block]:
    """List the causes of misses of each data set, and of all in the last line."""
    blocks: list[Block] = [
        Prose(
            "Mean IoU as it is, and with the truth in the place of one stage after another, from "
            "the end; each column keeps what those before it put right. The first that mends a "
            "miss, IoU and point, is what lost it."
        )
    ]
    columns = [Column("lost by", is_text=True), Column("Queries")]
    columns += [Column(title, help) for title, help in STAND_INS.values()]
    for (dataset,), queries in grouped(attribution, "dataset").items():
        by_stage = {stage or "no miss": rows for (stage,), rows in grouped(queries, "lost").items()}
        order = sorted(by_stage, key=lambda stage: (stage == "no miss", -len(by_stage[stage])))
        lines = []
        for stage in [*order, "all"]:
            rows = by_stage.get(stage, queries)
            ious = ([row[n] for row in rows if row[n] is not None] for n in STAND_INS)
            means = [number(float(np.mean(values)), 3) if values else None for values in ious]
            lines.append(line_of([stage, str(len(rows)), *means], "mean" * (stage == "all")))
        blocks.append(Table.of(columns, lines, f"Which stage lost them, {dataset}"))
    blocks.append(Terms({title: help for title, help in STAND_INS.values() if help}))
    return blocks


def _next_section(scene: look.Scene) -> Section:
    """List the commands that view a scene and build one from the reader's photographs."""
    field = shlex.quote(f"fields/{file_name(scene.name)}")
    text = (
        f"Walk through a scene and ask it words, in the folder of this report: `slgaussian view "
        f"{field}`. Make one of two photographs of your own, a step apart: `slgaussian field a.jpg "
        "b.jpg -o field/`, then `slgaussian view field/`."
    )
    return Section("What to do next", [Prose(text)], "next", link="Next")


def _scenes_section(
    scenes: Sequence[look.Scene], scores: Sequence[Row], data: Mapping[str, Any]
) -> Section:
    """List the metrics of every scene; ``scores`` are those of our method, first protocol."""
    blocks: list[Block] = [
        Prose(
            "Each scene's field is a folder below `fields/`, as `fields.parquet` names it; "
            "`slgaussian query` asks it. The mean gives every scene that has a number the same "
            "weight."
        )
    ]
    estimated = []
    for name, of in data.items():
        if (cameras := of.get("cameras", "given")) != "given":
            left_out = ", ".join(of.get("left_out", {}))
            aside = f"; without {left_out}, which cannot be placed" if left_out else ""
            estimated.append(f"{escape(name)} ({escape(cameras + aside)})")
    if estimated:
        blocks.append(Prose(f"Cameras were not given, but found, of {', '.join(estimated)}."))
    links = {scene.name: f"scene-{place}" for place, scene in enumerate(scenes)}
    tables = []
    for dataset in dict.fromkeys(scene.dataset for scene in scenes):
        metrics = {scene.name: scene.metrics for scene in scenes if scene.dataset == dataset}
        of_set = [score for score in scores if score["dataset"] == dataset]
        tables.append(metrics_table(metrics, of_set, dataset, links))
    terms = {c.title: c.help for table in tables for c in table.columns if c.help}
    return Section(
        "Scene by scene", [*blocks, *tables, Terms(terms)], "scenes", link="Scene by scene"
    )


def _manifest_section(manifest: Mapping[str, Any]) -> Section:
    """List settings, methods, versions and data."""
    heads = [Column("", is_text=True)] * 2
    blocks: list[Block] = [Table.of(heads, flatten({**manifest, "data": {}}))]
    if data := flatten(manifest.get("data", {})):
        blocks.append(Fold("Data of each scene, by digest", [Table.of(heads, data)]))
    note = "settings, methods, versions, data: with these it can be run again"
    return Section("What ran", blocks, "ran", note, "What ran", is_folded=True)
