"""What each method got right against what it cost: a table and two plots for each data set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from slgaussian.benchmark.costs import Cost
from slgaussian.benchmark.plots import plot_worth

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Worth:
    """A method on a data set.

    Attributes
    ----------
    method : str
    iou, low, high : float
        Mean IoU, 0 to 1, and its interval; no interval with a single place.
    hit : float or None
        Share of the points that are on the thing.
    cost : Cost
    quickest, smallest : bool
        Whether no other method of a higher or the same IoU answers quicker, or takes less memory:
        the Pareto front.
    """

    method: str
    iou: float
    low: float | None
    high: float | None
    hit: float | None
    cost: Cost
    quickest: bool
    smallest: bool


@dataclass(frozen=True)
class Tradeoff:
    """The methods of a data set, best IoU first, the judging sizes, and plots as SVG by caption."""

    dataset: str
    sizes: Sequence[str]
    lines: Sequence[Worth]
    plots: Mapping[str, str]


def tradeoffs(
    scores: Sequence[Row], sizes: Mapping[str, Sequence[str]], costs: Sequence[Cost]
) -> list[Tradeoff]:
    """One a data set of which something is scored and timed.

    Parameters
    ----------
    scores : rows of the spec ``scores``
        Those of one protocol.
    sizes : {dataset: texts}
        At which it was judged.
    costs : sequence of Cost
        Of the methods on the data sets, our own first.
    """
    found = []
    for dataset in dict.fromkeys(score["dataset"] for score in scores):
        own = {(s["method"], s["metric"]): s for s in scores if s["dataset"] == dataset}
        known = [
            cost
            for cost in costs
            if cost.dataset == dataset and (cost.method, "iou") in own and cost.view_query
        ]
        if not known:
            continue
        ious = [own[cost.method, "iou"]["value"] for cost in known]
        quick = front([cost.view_query for cost in known], ious)
        small = front([cost.grown for cost in known], ious)
        lines = []
        for cost, quickest, smallest in zip(known, quick, small, strict=True):
            iou, hit = own[cost.method, "iou"], own.get((cost.method, "hit_mask"))
            value, low, high = (iou[name] for name in ("value", "low", "high"))
            point = None if hit is None else hit["value"]
            lines.append(Worth(cost.method, value, low, high, point, cost, quickest, smallest))
        lines.sort(key=lambda line: -line.iou)
        costs_by = {
            "seconds of a query in a new view": [(w, w.cost.view_query) for w in lines],
            "memory beyond the scene, MB": [
                (w, w.cost.grown and w.cost.grown / 1e6) for w in lines
            ],
        }
        plots = {}
        for label, priced in costs_by.items():
            points = [(worth.method, worth.iou, price) for worth, price in priced if price]
            if points:
                plots[f"IoU over {label}; the line is the front"] = plot_worth(
                    points, costs[0].method, label
                )
        found.append(Tradeoff(dataset, sizes.get(dataset, ()), lines, plots))
    return found


def front(costs: Sequence[float | None], values: Sequence[float]) -> list[bool]:
    """Which have no other that costs no more and is worth no less, and is better in one of both.

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
