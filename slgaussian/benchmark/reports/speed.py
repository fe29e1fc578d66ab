"""The section of a report that no run repeats: speed against error, hard cases, the machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

from slgaussian.benchmark.baselines import is_swept
from slgaussian.benchmark.costs import Cost, Times, claim
from slgaussian.benchmark.reports.model import (
    Block,
    Cell,
    Column,
    Fold,
    Plots,
    Prose,
    Table,
    escape,
    flatten,
    number,
)
from slgaussian.benchmark.reports.plots import plot_worth
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


def speed_blocks(
    times: Times, rows: Sequence[Row], novel: Sequence[tuple[str, str, float]]
) -> list[Block]:
    """Describe what a run cost.

    Parameters
    ----------
    times : Times
    rows : rows of the spec ``samples``
        Set against the times; those of the first protocol count.
    novel : sequence of (data set, method, float)
        PSNR of new views, dB, a scene at a time.
    """
    first = of_first_protocol(rows)
    scores: dict[tuple[str, str], Row] = {}
    for method in dict.fromkeys(row["method"] for row in first):
        table = score_table([row for row in first if row["method"] == method])
        scores |= {
            (score["dataset"], method): score
            for score in table.to_pylist()
            if score["metric"] == "iou" and score["threshold"] is None
        }
    blocks: list[Block] = [
        Prose("Two runs on the same input differ in this section and in the seconds above alone.")
    ]
    for dataset in dict.fromkeys(cost.dataset for cost in times.costs):
        sizes = dict.fromkeys(
            f"{row['height']} x {row['width']}" for row in first if row["dataset"] == dataset
        )
        title = f"{dataset}, judged at {', '.join(sizes)} pixels (height x width)"
        costs = [cost for cost in times.costs if cost.dataset == dataset]
        blocks += _tradeoff(title, costs, scores, novel)
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
    scores: Mapping[tuple[str, str], Row],
    novel: Sequence[tuple[str, str, float]],
) -> list[Block]:
    """Set the scores of the methods of a data set against their costs, best first."""
    psnr = {
        cost.method: fmean(values)
        for cost in costs
        if (values := [v for *by, v in novel if by == [cost.dataset, cost.method]])
    }
    ious = {cost.method: scores.get((cost.dataset, cost.method)) for cost in costs}
    scored = any(ious.values())
    merits = {name: iou["value"] for name, iou in ious.items() if iou} if scored else psnr
    shown = [cost for cost in costs if cost.method in merits and cost.view_query]
    shown.sort(key=lambda cost: -merits[cost.method])
    if not shown:
        return []
    built = any(is_swept(cost.method) for cost in shown)
    values = [merits[cost.method] for cost in shown]
    seconds = [cost.whole if built else cost.view_query for cost in shown]
    memory = [None if cost.grown is None else cost.grown / 1e6 for cost in shown]
    fronts = {"time": front(seconds, values), "memory": front(memory, values)}
    columns: dict[str, list[Cell | str | None]] = {
        "Method": [cost.method for cost in shown],
        "IoU": [score_cell(ious[cost.method], 3) for cost in shown],
        "New view, PSNR": [number(psnr.get(cost.method), 1) for cost in shown],
        "To build, s": [number(cost.build, 2) for cost in shown],
        "To prepare, s": [number(cost.prepare, 3) for cost in shown],
        "Query in a new view, s": [number(cost.view_query, 4) for cost in shown],
        "Memory, MB": [number(value, 0) for value in memory],
        "Front": [
            ", ".join(name for name, on in fronts.items() if on[place])
            for place in range(len(shown))
        ],
    }
    score = "IoU" if scored else "PSNR of new views, dB"
    whole = "seconds from photographs to an answer" if built else "seconds of a query in a new view"
    plots = {}
    for label, prices in ((whole, seconds), ("memory beyond the scene, MB", memory)):
        points = [
            (cost.method, value, price)
            for cost, value, price in zip(shown, values, prices, strict=True)
            if price
        ]
        if points:
            caption = f"{score} over {label}; the line is the front"
            plots[caption] = plot_worth(points, costs[0].method, label, score)
    heads = [Column(head, is_text=head in ("Method", "Front")) for head in columns]
    table = Table.of(heads, list(zip(*columns.values(), strict=True)), title)
    sentence = claim(costs)
    return [table, Plots(plots), *[Prose(f"**{sentence}**", "")] * bool(sentence)]


def _paper_costs(times: Times) -> list[Block]:
    """Set what the paper prints (section 4.1, Table 4) beside a run, with what each measures."""
    tables: list[Block] = []
    infer = [times.stages[name].middle for name in ("geometry", "field") if name in times.stages]
    for cost in times.costs:
        if cost.method != times.paper:
            continue
        pairs = [other for other in times.costs if other.dataset == cost.dataset]
        flat = next((other.view_query for other in pairs if other.method == "query-2d"), None)
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
        lines = [(name, paper, number(ours, 4), about) for name, paper, ours, about in rows]
        heads = ["", "The paper, RTX 3090", "Here", Column("Measured here", is_text=True)]
        title = f"{cost.dataset}: the paper's costs at 416 x 576"
        tables.append(Table.of([Column("", is_text=True), *heads[1:]], lines, title))
    return tables


def front(costs: Sequence[float | None], values: Sequence[float]) -> list[bool]:
    """Say which have no other that costs no more, is worth no less, and is better in one of both.

    A cost of None is on no front.
    """
    return [
        cost is not None
        and not any(
            other is not None
            and other <= cost
            and worth >= value
            and (other < cost or worth > value)
            for other, worth in zip(costs, values, strict=True)
        )
        for cost, value in zip(costs, values, strict=True)
    ]


def _stages_table(times: Times) -> Table:
    whole = sum(cost.seconds for cost in times.stages.values()) or 1.0
    rows = [
        [
            stage,
            number(cost.middle, 2),
            number(cost.seconds, 2),
            f"{100 * cost.seconds / whole:.0f} %",
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
    cases = times.hard_cases
    beyond = [f"{case.case} ({case.part})" for case in cases if not case.good]
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
        for case in cases
    ]
    note = (
        "The greatest difference of what is computed in float32 from the same in float64, or "
        "longer numbers."
    )
    heads = ["Hard case", Column("Computed by", is_text=True), "Error", "Bound", ""]
    fold = Fold("Each case, its error and its bound", [Table.of(heads, rows, notes=[note])])
    return [Prose(f"Of {len(cases)} hard cases on {processor}, {verdict}", ""), fold]
