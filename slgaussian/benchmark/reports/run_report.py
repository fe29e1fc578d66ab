"""The report of a benchmark: a sentence, a few numbers, a scene to look at, then all the rest.

It depends on its arguments alone, same results, same bytes. What a run costs is put in afterwards
by :func:`with_times`: a section, and the seconds beside the first numbers.
"""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
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
from slgaussian.benchmark.reports.scenes import Scene, metrics_table
from slgaussian.benchmark.reports.score_tables import (
    MAIN,
    MORE,
    conditions,
    gain_cell,
    method_tables,
)
from slgaussian.benchmark.reports.speed import speed_blocks
from slgaussian.benchmark.reports.summary import summarize
from slgaussian.benchmark.scores import (
    GOOD,
    differences,
    key_of,
    of_first_protocol,
    score_table,
)
from slgaussian.datasets.published import Standing

Row = Mapping[str, Any]
Images = Mapping[str, np.ndarray]

MOST = 24
"""Scenes that get pictures: of more, those answered worst. All are in the tables."""

LEFT_OUT = 3
"""Scenes left out for one reason that are named."""

FIRST_SCORES = ("iou", "miou", "hit_mask", "hit_peak", "accuracy")
"""Metrics of the first table, in the order of its columns."""

TIMES = "<!-- times -->"
"""Where :func:`with_times` puts its section."""


def run_report(
    scenes: Sequence[Scene],
    manifest: Mapping[str, Any],
    failures: Sequence[Mapping[str, str]] = (),
    attribution: Sequence[Row] = (),
) -> Report:
    """Make the report of a run.

    Parameters
    ----------
    scenes : sequence of Scene
    manifest : mapping
        Versions, settings and data, nested mappings allowed. Of ``data``, by scene, ``published``
        says which published scene it is (the fields of
        :class:`slgaussian.datasets.published.Standing`), and ``cameras`` whether they were given.
    failures : sequence of mapping
        Scenes left out: ``scene``, ``stage``, ``reason`` (the columns of ``failures.parquet``).
    attribution : sequence of mapping
        Rows of the spec ``attribution``: what lost each miss of our method.
    """
    by_method: dict[str, list[Row]] = {}
    for scene in scenes:
        for row in scene.rows:
            by_method.setdefault(row["method"], []).append(row)
    ours, our_rows = next(iter(by_method.items()), ("", []))
    asked = of_first_protocol(our_rows)
    scores = [score for rows in by_method.values() for score in score_table(rows).to_pylist()]
    leading = [score for score in scores if asked and score["protocol"] == asked[0]["protocol"]]
    lost_by = {key_of(row): row["lost"] or "" for row in attribution}
    drawn = _draw(scenes, asked, lost_by)
    sections = [*drawn.looks, *map(_next_section, scenes[:1])]
    sections += _score_sections(by_method, scores, leading)
    if failures:
        sections.append(_failures_section(failures))
    sections.append(Section("Speed against error", [Slot(TIMES)], "times", link="Speed"))
    if drawn.worst:
        sections.append(_worst_section(asked, drawn, attribution))
    entries = manifest.get("data", {}).items()
    standing = {name: Standing(**of["published"]) for name, of in entries if of.get("published")}
    every = [row for rows in by_method.values() for row in rows]
    if (paper := paper_section(every, standing, ours)) is not None:
        sections.append(paper)
    if scenes:
        sections.append(_scenes_section(scenes, leading, ours, manifest))
    sections += [*drawn.scenes, _manifest_section(manifest)]
    opening = summarize(scenes, by_method, asked, leading, manifest, len(failures))
    return Report("SLGaussian report", opening, sections)


def with_times(
    pages: Mapping[str, str],
    times: Times,
    rows: Sequence[Row] = (),
    novel: Sequence[tuple[str, str, float]] = (),
) -> dict[str, str]:
    """Complete a report of :func:`run_report` with what is true of one run on one machine only.

    Parameters
    ----------
    pages : {form: text}
        The forms ``html`` and ``markdown`` of the report.
    times, rows, novel
        As :func:`slgaussian.benchmark.reports.speed.speed_blocks` takes them.
    """
    blocks = speed_blocks(times, rows, novel)
    costs = {(cost.dataset, cost.method): cost for cost in times.costs}

    def filled(match: re.Match[str]) -> str:
        dataset, method = (bytes.fromhex(match[k]).decode() for k in (2, 3))
        value = getattr(costs.get((dataset, method)), match[1], None)
        text = "–" if value is None else f"{value:,.0f}" if value >= 10 else f"{value:.2g}"
        return f'<span class="took">{text}</span>'

    html = re.sub(r"<!-- (\w+) ((?:[0-9a-f]{2})*) ((?:[0-9a-f]{2})*) -->", filled, pages["html"])
    return {
        "html": html.replace(TIMES, blocks_as("html", blocks)),
        "markdown": pages["markdown"].replace(TIMES, blocks_as("md", blocks)),
    }


@dataclass
class _Drawn:
    """The sections of pictures: scenes that open the page, the worst answers, and all scenes."""

    looks: list[Section]
    worst: list[tuple[Row, Card]]
    scenes: list[Section]


def _draw(scenes: Sequence[Scene], asked: Sequence[Row], lost_by: Mapping[look.Key, str]) -> _Drawn:
    """Draw the pictures of all scenes, of which one is in memory at a time."""
    worst = look.few_a_scene(look.ranked(asked), look.WORST)
    cards: dict[look.Key, Card] = {}
    opens = look.choose_scenes((one.name, one.dataset, one.metrics) for one in scenes)
    worst_first = sorted(scenes, key=lambda scene: scene.metrics.get("iou", 1.0))
    pictured = {scene.name for scene in worst_first[:MOST]}
    drawn = _Drawn([], [], [])
    for place, scene in enumerate(scenes):
        rows = [row for row in asked if row["scene"] == scene.name]
        chosen = [row for row in worst if row["scene"] == scene.name]
        shown = scene.name in pictured | opens.keys() or chosen
        images = scene.pictures() if shown else {}
        if scene.name in opens:
            reason = opens[scene.name]
            truth, masks = scene.truth(), scene.masks()
            drawn.looks.append(
                look.look_section(scene.name, reason, rows, images, truth, masks, lost_by)
            )
        for row in chosen:
            lost = lost_by.get(key_of(row), "")
            cards[key_of(row)] = look.answer_card(row, images, look.ANSWER, lost)
        id = f"scene-{place}"
        images = images if scene.name in pictured else {}
        drawn.scenes.append(
            look.scene_section(scene.name, id, rows, scene.metrics, images, scene.name in opens)
        )
    if drawn.looks:
        drawn.looks[0] = replace(drawn.looks[0], id="look", link="Look")
    drawn.worst = [(row, cards[key_of(row)]) for row in worst]
    return drawn


def _score_sections(
    by_method: Mapping[str, Sequence[Row]], scores: Sequence[Row], leading: Sequence[Row]
) -> Iterator[Section]:
    """Return one table a data set, and all scores folded up below."""
    if not leading:
        return
    ours, *others = by_method
    protocol = leading[0]["protocol"]
    shown = [
        score
        for metric in FIRST_SCORES
        for score in (*MAIN, *MORE)
        if score.metric == metric and score.protocol == protocol.partition("@")[0]
    ]
    first = {m: [r for r in rows if r["protocol"] == protocol] for m, rows in by_method.items()}
    gains = {
        (difference.dataset, method): difference
        for method in others
        for difference in differences(first[ours], first[method])
        if difference.metric == shown[0].metric
    }
    gain = Column(f"{ours} minus it", f"{shown[0].title}, on the queries and scenes that both have")
    blocks: list[Block] = []
    for table in method_tables(leading, shown):
        lines = []
        for line in sorted(table.lines, key=lambda line: line.cells[1].value, reverse=True):
            method = line.cells[0].value
            cells, style = list(line.cells), "ours" if others and method == ours else ""
            if gains:
                cells.append(gain_cell(gains.get((table.title, method)), shown[0], is_worded=True))
            lines.append(replace(line, cells=tuple(cells), style=style))
        columns = (*table.columns, gain) if gains else table.columns
        blocks.append(replace(table, columns=columns, lines=tuple(lines)))
    terms = {score.title: score.help for score in shown} | {
        "near-best": "all objects that lead the canonical phrases by the given share of the best "
        "one's lead"
    }
    blocks.append(Terms(terms))
    if others:
        note = "Best IoU first; the best of each column is bold. What is called “like” is not the "
        note += "original, but what it is known for on the same photographs, Gaussians and encoder."
        blocks.append(Prose(note))
    title = "How good, by method" if others else "How good"
    yield Section(title, blocks, "scores", link="Scores")
    second = {table.title: table for table in method_tables(scores, MORE)}
    every: list[Block] = []
    for table in method_tables(scores):
        every.append(table)
        if table.title in second:
            every.append(replace(second[table.title], title="By other protocols, and calibration"))
    yield Section("Every score", every, note="by every protocol", is_folded=True)


def _failures_section(failures: Sequence[Mapping[str, str]]) -> Section:
    """List scenes that were left out, those of one reason in one line."""
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


def _worst_section(asked: Sequence[Row], drawn: _Drawn, attribution: Sequence[Row]) -> Section:
    """Show the answers that scored least, and what lost them."""
    blocks: list[Block] = []
    for dataset in dict.fromkeys(row["dataset"] for row in asked):
        scored = [r for r in asked if r["dataset"] == dataset and r["iou"] is not None]
        low = {key_of(row) for row in scored if row["iou"] < GOOD}
        beside = {key_of(row) for row in scored if not row["hit_mask"]}
        if scored:
            text = f"**{escape(dataset)}**: {len(low | beside)} of {len(scored)} queries are "
            text += f"missed, {len(low)} with an IoU below {GOOD} and {len(beside)} with a point "
            blocks.append(Prose(f"{text}beside the object."))
    by = f"{escape(asked[0]['protocol'])} ({escape(conditions(asked[0]))})"
    blocks.append(Prose(f"Here are the lowest, a few of a scene, by {by}."))
    blocks += [look.ANSWER_TERMS, Cards([card for _, card in drawn.worst])]
    rows = [
        [
            row["query"],
            f"{row['scene']}, {row['frame']}",
            number(row["iou"], 3),
            f"predictions/{mask_place(row).as_posix()}",
        ]
        for row, _ in drawn.worst
    ]
    place, mask = (Column(name, is_text=True) for name in ("Scene and frame", "Mask"))
    blocks.append(Fold("Where their masks are", [Table.of(["Query", place, "IoU", mask], rows)]))
    if attribution:
        blocks += _attribution_blocks(attribution)
    return Section("Answered worst", blocks, "worst", link="Worst answers")


def _attribution_blocks(attribution: Sequence[Row]) -> list[Block]:
    """Say what lost the queries of each data set, and of all of them in the last line."""
    blocks: list[Block] = [
        Prose(
            "Mean IoU as it is, and with the truth in the place of one stage after another, from "
            "the end; each column keeps what those before it put right. The first that mends a "
            "miss, IoU and point, is what lost it."
        )
    ]
    columns = [Column("lost by", is_text=True), Column("Queries")]
    columns += [Column(title, help) for title, help in STAND_INS.values()]
    for dataset in dict.fromkeys(row["dataset"] for row in attribution):
        queries = [row for row in attribution if row["dataset"] == dataset]
        counts = Counter(row["lost"] or "no miss" for row in queries)
        lines = []
        for lost in [
            *sorted(counts, key=lambda stage: (stage == "no miss", -counts[stage])),
            "all",
        ]:
            rows = [row for row in queries if lost in (row["lost"] or "no miss", "all")]
            ious = ([row[n] for row in rows if row[n] is not None] for n in STAND_INS)
            means = [number(float(np.mean(values)), 3) if values else None for values in ious]
            style = "mean" if lost == "all" else ""
            lines.append(line_of([lost, str(len(rows)), *means], style=style))
        blocks.append(Table(tuple(columns), tuple(lines), f"Which stage lost them, {dataset}"))
    blocks.append(Terms({title: help for title, help in STAND_INS.values() if help}))
    return blocks


def _next_section(scene: Scene) -> Section:
    """Name the commands that look at a scene and make one of the reader's photographs."""
    field = shlex.quote(f"fields/{file_name(scene.name)}")
    text = (
        f"Walk through a scene and ask it words, in the folder of this report: `slgaussian view "
        f"{field}`. Make one of two photographs of your own, a step apart: `slgaussian field a.jpg "
        "b.jpg -o field/`, then `slgaussian view field/`."
    )
    return Section("What to do next", [Prose(text)], "next", link="Next")


def _scenes_section(
    scenes: Sequence[Scene], leading: Sequence[Row], ours: str, manifest: Mapping[str, Any]
) -> Section:
    """List the metrics of every scene."""
    blocks: list[Block] = [
        Prose(
            "Each scene's field is a folder below `fields/`, by the name that `fields.csv` has; "
            "`slgaussian query` asks it. The mean gives every scene that has a number the same "
            "weight."
        )
    ]
    estimated = []
    for name, of in manifest.get("data", {}).items():
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
        scores = [s for s in leading if (s["dataset"], s["method"]) == (dataset, ours)]
        tables.append(metrics_table(metrics, scores, dataset, links))
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
