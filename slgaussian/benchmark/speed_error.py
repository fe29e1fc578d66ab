"""Speed against error: a table and plots of what each method gets right and costs, by data set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import fmean
from typing import Any

from slgaussian.benchmark.baselines import is_swept
from slgaussian.benchmark.costs import Cost
from slgaussian.benchmark.plots import plot_worth

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Worth:
    """A method on a data set.

    Attributes
    ----------
    method : str
    iou, low, high : float or None
        Mean IoU, 0 to 1, and its interval; no interval with a single place, none without labels.
    hit : float or None
        Share of the points that are on the thing.
    psnr : float or None
        Of rendered new views against photographs, dB; without labels it stands for the IoU.
    cost : Cost
    quickest, smallest : bool
        Whether no other method of a higher or the same score answers quicker, or takes less memory:
        the Pareto front.
    """

    method: str
    iou: float | None
    low: float | None
    high: float | None
    hit: float | None
    psnr: float | None
    cost: Cost
    quickest: bool = False
    smallest: bool = False

    @property
    def seconds(self) -> float | None:
        """Seconds of a query in a new view."""
        return self.cost.view_query

    @property
    def whole(self) -> float | None:
        """Seconds from photographs to an answer in a new view."""
        if self.cost.build is None or self.seconds is None:
            return None
        return self.cost.build + self.seconds


@dataclass(frozen=True)
class Tradeoff:
    """The methods of a data set, best score first, the judging sizes, and plots as SVG by caption.

    With ``built``, methods have fields of their own, and the time is that of building as well.
    """

    dataset: str
    built: bool
    sizes: Sequence[str]
    lines: Sequence[Worth]
    plots: Mapping[str, str]


def tradeoffs(
    scores: Sequence[Row],
    sizes: Mapping[str, Sequence[str]],
    costs: Sequence[Cost],
    novel: Sequence[tuple[str, str, float]] = (),
) -> list[Tradeoff]:
    """Set what methods get right against what they cost, a data set at a time.

    Parameters
    ----------
    scores : rows of the spec ``scores``
        Those of one protocol.
    sizes : {dataset: texts}
        At which it was judged.
    costs : sequence of Cost
        Of the methods on the data sets, our own first.
    novel : sequence of (data set, method, float)
        PSNR of new views, dB, a scene at a time.
    """
    made = []
    for dataset in dict.fromkeys(cost.dataset for cost in costs):
        by_name = {(s["method"], s["metric"]): s for s in scores if s["dataset"] == dataset}
        lines = [
            _worth(cost, by_name, [value for of, method, value in novel
                                   if (of, method) == (dataset, cost.method)])
            for cost in costs
            if cost.dataset == dataset
        ]  # fmt: skip
        scored = any(line.iou is not None for line in lines)
        score = "iou" if scored else "psnr"
        lines = [line for line in lines if getattr(line, score) is not None and line.seconds]
        if not lines:
            continue
        built = any(is_swept(line.method) for line in lines)
        values = [getattr(line, score) for line in lines]
        times = [line.whole if built else line.seconds for line in lines]
        quick, small = front(times, values), front([line.cost.grown for line in lines], values)
        priced = {
            "seconds from photographs to an answer" if built
            else "seconds of a query in a new view": times,
            "memory beyond the scene, MB": [
                line.cost.grown and line.cost.grown / 1e6 for line in lines
            ],
        }  # fmt: skip
        title = "IoU" if scored else "PSNR of new views, dB,"
        plots = {}
        for label, prices in priced.items():
            points = [
                (line.method, value, price)
                for line, value, price in zip(lines, values, prices, strict=True)
                if price
            ]
            if points:
                plots[f"{title} over {label}; the line is the front"] = plot_worth(
                    points, costs[0].method, label, title.partition(",")[0]
                )
        marked = [
            replace(line, quickest=one, smallest=other)
            for line, one, other in zip(lines, quick, small, strict=True)
        ]
        marked.sort(key=lambda line: -getattr(line, score))
        made.append(Tradeoff(dataset, built, sizes.get(dataset, ()), marked, plots))
    return made


def _worth(cost: Cost, scores: Mapping[tuple[str, str], Row], psnrs: Sequence[float]) -> Worth:
    iou, hit = (scores.get((cost.method, name)) for name in ("iou", "hit_mask"))
    value, low, high = (None if iou is None else iou[name] for name in ("value", "low", "high"))
    psnr = fmean(psnrs) if psnrs else None
    return Worth(cost.method, value, low, high, None if hit is None else hit["value"], psnr, cost)


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
