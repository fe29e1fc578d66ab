"""Section of a report that is not reproducible from run to run: costs and machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

from slgaussian.benchmark.baselines import is_swept
from slgaussian.benchmark.costs import Cost, Times
from slgaussian.benchmark.reports.model import Block, Column, Prose, Table, number, values_table
from slgaussian.benchmark.reports.score_tables import score_cell
from slgaussian.benchmark.scores import of_first_protocol, score_table

Row = Mapping[str, Any]

COSTS_CAPTION = (
    "**Pareto front**: no other method has at least the same score in at most the same time. Times "
    "are medians over scenes of wall time on this machine; other scenes may have run at the same "
    "time. **Build**: from photographs to a field, which methods share. **Prepare**: additional "
    "work of the method for each scene. If methods have "
    "fields of their own, the time of the front is building plus query."
)

STAGES_CAPTION = (
    "**Per scene**: median; for baselines, median over methods and scenes. **Memory**: largest "
    "memory of the process until its end. Both were measured when the result was computed, "
    "possibly in an earlier run."
)


def speed_blocks(
    times: Times, rows: Sequence[Row], novel: Sequence[tuple[str, str, float]]
) -> list[Block]:
    """Return the blocks on the costs of a run.

    ``rows`` are of the spec ``samples``; their scores by the first protocol are compared with the
    times. ``novel`` are (data set, method, PSNR of held-out views in dB), one per scene.
    """
    leading = of_first_protocol(rows)
    ious = {
        (score["dataset"], score["method"]): score
        for score in score_table(leading).to_pylist()
        if score["metric"] == "iou"
    }
    blocks: list[Block] = [Prose("Only this section changes if a run is repeated.")]
    for dataset in dict.fromkeys(cost.dataset for cost in times.costs):
        sizes = dict.fromkeys(
            f"{row['height']} x {row['width']}" for row in leading if row["dataset"] == dataset
        )
        title = f"{dataset}, evaluated at {', '.join(sizes)} pixels (height x width)"
        costs = [cost for cost in times.costs if cost.dataset == dataset]
        scores = {cost.method: ious.get((dataset, cost.method)) for cost in costs}
        decibels = {
            cost.method: fmean(values)
            for cost in costs
            if (values := [v for *names, v in novel if names == [dataset, cost.method]])
        }
        blocks.append(_scores_by_cost(title, costs, scores, decibels))
    if len(blocks) > 1:
        blocks.append(Prose(COSTS_CAPTION))
    blocks += [_paper_costs(cost, times) for cost in times.costs if cost.method == times.paper]
    if times.stages:
        blocks.append(_stages_table(times))
    return [*blocks, values_table(times.host, "Machine")]


def _scores_by_cost(
    title: str,
    costs: Sequence[Cost],
    ious: Mapping[str, Row | None],
    decibels: Mapping[str, float],
) -> Table:
    """Compare scores and costs of the methods of a data set, best first."""
    values = {method: row["value"] for method, row in ious.items() if row} or decibels
    has_fields = any(is_swept(cost.method) for cost in costs)
    points = {
        c.method: (seconds, values[c.method])
        for c in costs
        if c.method in values and (seconds := c.total if has_fields else c.view_query)
    }
    front = pareto_front(list(points.values()))
    rows = [
        [
            cost.method,
            score_cell(ious[cost.method], 3),
            number(decibels.get(cost.method), 1),
            number(cost.build, 2),
            number(cost.prepare, 3),
            number(cost.view_query, 4),
            "yes" if points.get(cost.method) in front else "",
        ]
        for cost in sorted(costs, key=lambda cost: -values.get(cost.method, 0))
    ]
    heads = ["Method", "IoU", "PSNR, dB", "Build, s", "Prepare, s", "Query in a new view, s"]
    return Table([*heads, "Pareto front"], rows, title)


def _paper_costs(cost: Cost, times: Times) -> Table:
    """Compare our costs with those of the paper (section 4.1, Table 4), with definitions."""
    infer = [times.stages[name].middle for name in ("geometry", "field") if name in times.stages]
    view, further = cost.view_query, cost.further_query
    draw = None if view is None or further is None else view - further
    query_2d = (c for c in times.costs if (c.dataset, c.method) == (cost.dataset, "query-2d"))
    peak = None if cost.peak is None else cost.peak / 1e9
    rows = [
        ("inference per scene, s", "0.3", sum(infer) or None, "stages geometry and field"),
        ("scene, s", "25", cost.build, "stages geometry, masks, supervision and field"),
        ("rendering, s", "0.0006", draw, "first query in a view minus a further query"),
        ("query, s", "0.011", view, "query in a new view, including rendering"),
        ("2D query, s", "18", next((c.view_query for c in query_2d), None), "method query-2d"),
        ("memory on each of two GPUs, GB", "9", peak, "largest memory of the process, without GPU"),
        ("memory on one GPU, GB", "6", peak, "the same"),
    ]
    heads = ["Cost", "Paper, RTX 3090", "This machine", Column("Definition here", is_text=True)]
    lines = [[name, paper, number(ours, 4), text] for name, paper, ours, text in rows]
    return Table(heads, lines, f"{cost.dataset}: costs in the paper at 416 x 576")


def pareto_front(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the (cost, value) points that no other point beats in one and equals in the other."""
    return [
        (cost, value)
        for cost, value in points
        if not any(c <= cost and v >= value and (c, v) != (cost, value) for c, v in points)
    ]


def _stages_table(times: Times) -> Table:
    total = sum(cost.seconds for cost in times.stages.values()) or 1.0
    rows = []
    for stage, cost in times.stages.items():
        seconds = number(cost.middle, 2), number(cost.seconds, 2)
        share = f"{100 * cost.seconds / total:.0f} %"
        rows.append([stage, *seconds, share, number(cost.peak, 0, 1e6)])
    note = STAGES_CAPTION
    if times.compiling >= 0.5:
        note += f" Compiling kernels, once per installation, took {times.compiling:.0f} s more."
    heads = ["Stage", "Per scene, s", "Total, s", "Share", "Memory, MB"]
    return Table(heads, rows, "Time by stage", [note])
