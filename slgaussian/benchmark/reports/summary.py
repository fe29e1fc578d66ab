"""Summary at the top of a report: sentences and key numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from slgaussian.benchmark.baselines import is_variant
from slgaussian.benchmark.costs import Cost
from slgaussian.benchmark.evaluate import NOT_UNDERSTOOD
from slgaussian.benchmark.reports.examples import Scene
from slgaussian.benchmark.reports.model import (
    Block,
    Cell,
    Column,
    Prose,
    Slot,
    Table,
    count_text,
    escape,
    number,
)
from slgaussian.benchmark.reports.score_tables import HIT_MASK, IOU, PSNR, mean_cells

Row = Mapping[str, Any]

COSTS = "<!-- costs -->"
"""Placeholder of the seconds, see :func:`key_costs`."""


def summarize(
    scenes: Sequence[Scene],
    methods: Sequence[str],
    answers: Sequence[Row],
    scores: Sequence[Row],
    manifest: Mapping[str, Any],
    left_out: int,
) -> list[Block]:
    """Summarise a run in sentences and key numbers.

    ``methods`` begin with ours. ``answers`` are rows of the spec ``samples`` of our method, and
    ``scores`` rows of the spec ``scores`` of all methods, in the first protocol. ``left_out`` is
    the number of scenes that are not in the report.
    """
    if not scenes:
        return [Prose(f"No scene was completed; {left_out} left out.", "lead")]
    data = list(manifest.get("data", {}).values())
    sizes = sorted({len(scene["context"]) for scene in data if "context" in scene})
    is_held_out = data and all(
        {*scene.get("context", ())}.isdisjoint(scene.get("targets", ())) for scene in data
    )
    names = dict.fromkeys(s.name if len(scenes) == 1 else s.dataset for s in scenes)
    text = f"Semantic fields of {count_text(len(scenes), 'scene')} "
    text += f"({', '.join(map(escape, names))})"
    if sizes:
        text += f", built from {' to '.join(map(str, dict.fromkeys((sizes[0], sizes[-1]))))} "
        text += f"photographs{' each' if len(scenes) > 1 else ''}"
    scored = sum(row["iou"] is not None for row in answers)
    text += f". {count_text(scored or len(answers), 'query', 'queries')} "
    if scored:
        text += "scored in held-out views" if is_held_out else "scored"
    else:
        text += "without ground truth, not scored"
    variants = sum(map(is_variant, methods[1:]))
    counts = {"baseline": len(methods) - 1 - variants, "variant": variants}
    if compared := [count_text(n, kind) for kind, n in counts.items() if n]:
        text += f", compared with {' and '.join(compared)}"
    unknown = sum(row["note"].startswith(NOT_UNDERSTOOD) for row in answers)
    exceptions = {
        f"[Scenes left out](#left-out): {left_out}.": left_out,
        f"Other queries, without ground truth: {len(answers) - scored}.": 0 < scored < len(answers),
        f"Queries that the encoder does not understand (IoU 0): {unknown}.": unknown,
    }
    blocks: list[Block] = [Prose(f"{text}.", "lead")]
    if listed := [part for part, holds in exceptions.items() if holds]:
        blocks.append(Prose(" ".join(listed), "soft fine"))
    return [*blocks, *_key_scores(scenes, scores, next(iter(methods), "")), Slot(COSTS)]


def _key_scores(scenes: Sequence[Scene], scores: Sequence[Row], ours: str) -> list[Table]:
    """Return the main scores of our method and of the best baseline, a line per data set."""
    columns = [
        column
        for column in (IOU, HIT_MASK, PSNR)
        if any(column.metric in scene.metrics for scene in scenes)
    ]
    if not columns:
        return []
    lines = []
    for dataset in dict.fromkeys(scene.dataset for scene in scenes):
        metrics = {scene.name: scene.metrics for scene in scenes if scene.dataset == dataset}
        of_set = [score for score in scores if score["dataset"] == dataset]
        cells = [Cell(dataset)]
        our_scores = [score for score in of_set if score["method"] == ours]
        means = mean_cells(metrics, our_scores, columns)
        for column, cell in zip(columns, means, strict=True):
            baselines = [
                (score["value"], score["method"])
                for score in of_set
                if score["metric"] == column.metric
                and score["method"] != ours
                and not is_variant(score["method"])
            ]
            parts = [cell.below] if cell.below else []
            if baselines:
                value, method = max(baselines)
                parts.append(f"best baseline: {value:.{column.digits}f}, {method}")
            cells.append(replace(cell, below="; ".join(parts)))
        lines.append(cells)
    return [Table.of(["Data set", *(column.column for column in columns)], lines, style="key")]


def key_costs(costs: Sequence[Cost]) -> Table:
    """Return the seconds of our method on each data set, the first method of ``costs`` in it."""
    ours = {cost.dataset: cost for cost in reversed(costs)}
    lines = [
        [dataset, number(cost.view_query, 3), number(cost.build, 1)]
        for dataset, cost in reversed(ours.items())
    ]
    heads = ["Data set", Column("Query in a new view, s", "median, including rendering"),
             Column("Build a scene, s", "median, from photographs to a field")]  # fmt: skip
    return Table.of(heads, lines, style="key")
