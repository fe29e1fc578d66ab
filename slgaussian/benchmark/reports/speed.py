"""Section of a report that is not reproducible from run to run: costs, hard cases, machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

from slgaussian.benchmark.baselines import is_swept
from slgaussian.benchmark.costs import Cost, Times
from slgaussian.benchmark.reports.model import (
    Block,
    Cell,
    Column,
    Fold,
    Gallery,
    Prose,
    Table,
    escape,
    flatten,
    number,
)
from slgaussian.benchmark.reports.plots import plot_pareto
from slgaussian.benchmark.reports.score_tables import score_cell
from slgaussian.benchmark.scores import of_first_protocol, score_table

Row = Mapping[str, Any]

FRONT = (
    "**Front**: no other method has as good a score in less time, or with less memory. Best first. "
    "Seconds are medians over scenes, of wall time on this machine, while other scenes may have "
    "been worked on. Methods share the Gaussians and the field; to prepare is what a method does "
    "to a scene beyond that. Where methods have fields of their own, the time of the front is that "
    "of building and a query."
)

STAGES = (
    "**A scene**: the median; of baselines, that of one method in one scene. **Memory**: the most "
    "beyond what was held when the stage began. Geometry, masks, supervision and field build the "
    "scene. Of when each result was made, which may have been in an earlier run; scenes that were "
    "worked on at the same time count each."
)

HARD_CASES = (
    "The greatest difference of what is computed in float32 from the same in float64, or longer "
    "numbers."
)


def speed_blocks(
    times: Times, rows: Sequence[Row], novel: Sequence[tuple[str, str, float]]
) -> list[Block]:
    """Return the blocks on the costs of a run.

    Parameters
    ----------
    times : Times
    rows : rows of the spec ``samples``
        Scores to compare with the times; only the first protocol is used.
    novel : sequence of (data set, method, float)
        PSNR of new views, dB, one per scene.
    """
    leading = of_first_protocol(rows)
    ious = {
        (score["dataset"], score["method"]): score
        for score in score_table(leading).to_pylist()
        if score["metric"] == "iou"
    }
    text = "Two runs on the same input differ in this section and in the seconds above alone."
    blocks: list[Block] = [Prose(text)]
    for dataset in dict.fromkeys(cost.dataset for cost in times.costs):
        sizes = dict.fromkeys(
            f"{row['height']} x {row['width']}" for row in leading if row["dataset"] == dataset
        )
        title = f"{dataset}, judged at {', '.join(sizes)} pixels (height x width)"
        costs = [cost for cost in times.costs if cost.dataset == dataset]
        blocks += _tradeoff(title, costs, ious, novel)
    if len(blocks) > 1:
        blocks.append(Prose(FRONT))
    blocks += _paper_costs(times)
    if times.stages:
        blocks.append(_stages_table(times))
    if times.hard_cases:
        blocks += _hard_cases(times)
    host = [*flatten(times.host)]
    for name, count in times.machines.items():
        if name != times.host.get("processor"):
            host.append(("made elsewhere", f"{count} results, with their seconds, on {name}"))
    if host:
        blocks.append(Table.of(["", Column("", is_text=True)], host, "Machine"))
    return blocks


def _tradeoff(
    title: str,
    costs: Sequence[Cost],
    ious: Mapping[tuple[str, str], Row],
    novel: Sequence[tuple[str, str, float]],
) -> list[Block]:
    """Compare the scores of the methods of a data set with their costs, best first."""
    psnr = {
        cost.method: fmean(values)
        for cost in costs
        if (values := [v for *name, v in novel if name == [cost.dataset, cost.method]])
    }
    by_method = {c.method: row for c in costs if (row := ious.get((c.dataset, c.method)))}
    merits = {method: row["value"] for method, row in by_method.items()} or psnr
    score = "IoU" if by_method else "PSNR of new views, dB"
    ranked = [cost for cost in costs if cost.method in merits and cost.view_query]
    ranked.sort(key=lambda cost: -merits[cost.method])
    if not ranked:
        return []
    has_fields = any(is_swept(cost.method) for cost in ranked)
    label = "seconds of a query in a new view"
    if has_fields:
        label = "seconds from photographs to an answer"
    values = [merits[cost.method] for cost in ranked]
    seconds = [cost.total if has_fields else cost.view_query for cost in ranked]
    memory = [None if cost.grown is None else cost.grown / 1e6 for cost in ranked]
    fronts = {"time": pareto_front(seconds, values), "memory": pareto_front(memory, values)}
    rows = [
        [
            cost.method,
            score_cell(by_method.get(cost.method), 3),
            number(psnr.get(cost.method), 1),
            number(cost.build, 2),
            number(cost.prepare, 3),
            number(cost.view_query, 4),
            number(cost.grown, 0, 1e6),
            ", ".join(name for name, members in fronts.items() if members[k]),
        ]
        for k, cost in enumerate(ranked)
    ]
    heads = ["Method", "IoU", "New view, PSNR", "To build, s", "To prepare, s",
             "Query in a new view, s", "Memory, MB", Column("Front", is_text=True)]  # fmt: skip
    plots = []
    for name, prices in ((label, seconds), ("memory beyond the scene, MB", memory)):
        points = [
            (cost.method, value, price)
            for cost, value, price in zip(ranked, values, prices, strict=True)
            if price
        ]
        if points:
            plots.append(plot_pareto(points, costs[0].method, name, score))
    return [Table.of(heads, rows, title), Gallery(plots, "grid plots")]


def _paper_costs(times: Times) -> list[Block]:
    """Compare the costs in the paper (section 4.1, Table 4) with a run, with definitions."""
    tables: list[Block] = []
    infer = [times.stages[name].middle for name in ("geometry", "field") if name in times.stages]
    for cost in times.costs:
        if cost.method != times.paper:
            continue
        of_set = [rival for rival in times.costs if rival.dataset == cost.dataset]
        flat = next((rival.view_query for rival in of_set if rival.method == "query-2d"), None)
        view, further = cost.view_query, cost.further_query
        draw = None if view is None or further is None else view - further
        peak = None if cost.peak is None else cost.peak / 1e9
        rows = [
            ("inference of a scene, s", "0.3", sum(infer) or None, "stages geometry and field"),
            ("a scene, s", "25", cost.build, "stages geometry, masks, supervision and field"),
            ("a rendering, s", "0.0006", draw, "a view and its first query, less a further query"),
            ("a query, s", "0.011", view, "a query in a new view, with its rendering"),
            ("a 2D query, s", "18", flat, "the same by query-2d"),
            ("memory on each of two GPUs, GB", "9", peak, "most that the process held, no GPU"),
            ("memory on one GPU, GB", "6", peak, "the same"),
        ]
        lines = [(name, paper, number(ours, 4), text) for name, paper, ours, text in rows]
        heads = ["", "The paper, RTX 3090", "Here", Column("Measured here", is_text=True)]
        title = f"{cost.dataset}: the paper's costs at 416 x 576"
        tables.append(Table.of([Column("", is_text=True), *heads[1:]], lines, title))
    return tables


def pareto_front(costs: Sequence[float | None], values: Sequence[float]) -> list[bool]:
    """Find the Pareto front: no other point costs at most as much and scores at least as well,
    unless equal.

    A point without a cost is not on the front.
    """
    points = list(zip(costs, values, strict=True))
    return [
        cost is not None
        and not any(
            price is not None
            and price <= cost
            and worth >= value
            and (price, worth) != (cost, value)
            for price, worth in points
        )
        for cost, value in points
    ]


def _stages_table(times: Times) -> Table:
    total = sum(cost.seconds for cost in times.stages.values()) or 1.0
    rows = [
        [
            stage,
            number(cost.middle, 2),
            number(cost.seconds, 2),
            f"{100 * cost.seconds / total:.0f} %",
            number(cost.grown, 0, 1e6),
        ]
        for stage, cost in times.stages.items()
    ]
    note = STAGES
    if times.compiling >= 0.5:
        note += (
            f" Compiling kernels, once an installation, took {times.compiling:.0f} s more; it is "
            "in no number here."
        )
    heads = ["Stage", "A scene, s", "All, s", "Share", "Memory, MB"]
    return Table.of(heads, rows, "Where the time goes, by stage", [note])


def _hard_cases(times: Times) -> list[Block]:
    beyond = [f"{case.case} ({case.part})" for case in times.hard_cases if not case.good]
    processor = escape(times.host.get("processor") or "this machine")
    verdict = "all are within their bounds."
    if beyond:
        verdict = f"**{len(beyond)} are beyond their bounds**: {', '.join(beyond)}."
    rows = [
        [
            Cell(case.case, note=case.about),
            case.part,
            f"{case.error:.1e} {case.measure}",
            f"{case.bound:.0e}",
            Cell("ok", mark="yes") if case.good else Cell("beyond", mark="no"),
        ]
        for case in times.hard_cases
    ]
    heads = ["Hard case", Column("Computed by", is_text=True), "Error", "Bound", ""]
    return [
        Prose(f"Of {len(rows)} hard cases on {processor}, {verdict}", ""),
        Fold("Each case, its error and its bound", [Table.of(heads, rows, notes=[HARD_CASES])]),
    ]
