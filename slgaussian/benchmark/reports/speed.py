"""Section of a report that is not reproducible from run to run: costs and machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from statistics import fmean
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from slgaussian.benchmark.costs import Cost, Times
from slgaussian.benchmark.reports import model
from slgaussian.benchmark.reports.figures import MUTED_COLOUR, svg_picture
from slgaussian.benchmark.reports.model import Block, Column, Prose, Table, number
from slgaussian.benchmark.reports.score_tables import score_cell
from slgaussian.benchmark.scores import Rows, score_table

Row = Mapping[str, Any]

COSTS_CAPTION = (
    "**Pareto front**: no other method has at most the same error in at most the same time, of a "
    "scene or of a query; in the figure a line. Bars are the intervals of the table. Times are "
    "medians over scenes of wall time on this machine; other scenes may have run at the same time. "
    "**Build**: from photographs to a field, which methods share unless its settings are swept. "
    "**Prepare**: additional work of the method for each scene. **A scene**: build, prepare, and "
    "the first query."
)

STAGES_CAPTION = (
    "**Per scene**: median; for baselines, median over methods and scenes. Measured when the "
    "result was computed, possibly in an earlier run."
)

FRONTS = ("scene", "query")
"""Times that have a Pareto front: of a scene, which the figure shows, and of a query."""

FIGURE_WIDTH, FIGURE_HEIGHT, LEGEND_ROW = 5.2, 3.4, 0.21
"""Size of the figure without its legend, and height of a row of the legend, inches."""


def speed_blocks(times: Times, rows: Rows, novel: Sequence[tuple[str, str, float]]) -> list[Block]:
    """Return the blocks on the costs of a run.

    ``rows`` are of the spec ``samples``; their scores by the first protocol are compared with the
    times. ``novel`` are (data set, method, PSNR of held-out views in dB), one per scene.
    """
    ious = {
        (score["dataset"], score["method"]): score
        for score in score_table(rows.leading).to_pylist()
        if score["metric"] == "iou"
    }
    blocks: list[Block] = [Prose("Only this section changes if a run is repeated.")]
    for dataset in dict.fromkeys(cost.dataset for cost in times.costs):
        samples = rows.leading.where(dataset=dataset)
        sizes = dict.fromkeys(f"{row['height']} x {row['width']}" for row in samples)
        title = f"{dataset}, evaluated at {', '.join(sizes)} pixels (height x width)"
        costs = [cost for cost in times.costs if cost.dataset == dataset]
        scores = {cost.method: ious.get((dataset, cost.method)) for cost in costs}
        decibels = {
            cost.method: fmean(values)
            for cost in costs
            if (values := [v for *names, v in novel if names == [dataset, cost.method]])
        }
        blocks += _scores_by_cost(title, costs, scores, decibels)
    if len(blocks) > 1:
        blocks.append(Prose(COSTS_CAPTION))
    blocks += [_paper_costs(cost, times) for cost in times.costs if cost.method == times.paper]
    if times.stages:
        blocks.append(_stages_table(times))
    return [*blocks, model.values_table(times.host, "Machine")]


def _scores_by_cost(
    title: str,
    costs: Sequence[Cost],
    ious: Mapping[str, Row | None],
    decibels: Mapping[str, float],
) -> list[Block]:
    """Compare scores and costs of the methods of a data set, best first, as table and figure.

    The error of a method is 1 - IoU; if no method has an IoU, the RMS error of held-out views.
    """
    label, errors = "error, 1 − IoU", {name: 1 - row["value"] for name, row in ious.items() if row}
    if not errors:
        label = "RMS error of held-out views"
        errors = {name: 10 ** (-value / 20) for name, value in decibels.items()}
    points: dict[str, dict[str, tuple[float, float]]] = {kind: {} for kind in FRONTS}
    for cost in (cost for cost in costs if cost.method in errors):
        for kind, seconds in (("scene", cost.total), ("query", cost.view_query)):
            if seconds:
                points[kind][cost.method] = seconds, errors[cost.method]
    fronts = {kind: pareto_front(list(named.values())) for kind, named in points.items()}
    rows = [
        [
            cost.method,
            score_cell(ious[cost.method], 3),
            number(decibels.get(cost.method), 1),
            number(cost.build, 2),
            number(cost.prepare, 3),
            number(cost.view_query, 4),
            ", ".join(kind for kind in FRONTS if points[kind].get(cost.method) in fronts[kind]),
        ]
        for cost in sorted(costs, key=lambda cost: errors.get(cost.method, 1))
    ]
    heads = ["Method", "IoU", "PSNR, dB", "Build, s", "Prepare, s", "Query in a new view, s"]
    blocks: list[Block] = [Table([*heads, "Pareto front"], rows, title)]
    if len(errors) > 1 and points["scene"]:
        size = FIGURE_WIDTH, FIGURE_HEIGHT + LEGEND_ROW * len(errors)
        draw = partial(_draw, points["scene"], ious, fronts["scene"], label)
        picture = svg_picture(draw, size, f"{label}, by seconds for a scene")
        blocks.append(model.Gallery([picture], "grid plots"))
    return blocks


def _draw(
    points: Mapping[str, tuple[float, float]],
    ious: Mapping[str, Row | None],
    front: Sequence[tuple[float, float]],
    label: str,
    axes: Axes,
) -> None:
    """Draw the (seconds, error) of methods with intervals of the error, and their front."""
    for place, (name, (x, y)) in enumerate(points.items()):
        (dot,) = axes.plot(x, y, "o", label=name, zorder=3, gid=f"method-{place}")
        if (row := ious.get(name)) and row["low"] is not None:
            axes.vlines(x, 1 - row["high"], 1 - row["low"], color=dot.get_color(), alpha=0.6)
    axes.step(*np.transpose(sorted(set(front))), where="post", color=MUTED_COLOUR, lw=0.8)
    axes.set(xscale="log", xlabel="seconds for a scene (log)", ylabel=label)
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_ylim(0)
    axes.grid()
    axes.figure.legend(loc="outside lower left", frameon=False, fontsize=8.5)


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
    """Return the (cost, error) points that no other point beats in one and equals in the other."""
    return [
        (cost, error)
        for cost, error in points
        if not any(c <= cost and e <= error and (c, e) != (cost, error) for c, e in points)
    ]


def _stages_table(times: Times) -> Table:
    total = sum(cost.seconds for cost in times.stages.values()) or 1.0
    rows = []
    for stage, cost in times.stages.items():
        seconds = number(cost.middle, 2), number(cost.seconds, 2)
        share = f"{100 * cost.seconds / total:.0f} %"
        rows.append([stage, *seconds, share])
    note = STAGES_CAPTION
    if times.compiling >= 0.5:
        note += f" Compiling kernels, once per installation, took {times.compiling:.0f} s more."
    heads = ["Stage", "Per scene, s", "Total, s", "Share"]
    return Table(heads, rows, "Time by stage", [note])
