"""A scene of a report, and the table of scenes with their metrics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from slgaussian.benchmark.reports.model import Cell, Column, Line, Table, line_of, number
from slgaussian.benchmark.reports.score_tables import score_cell

Row = Mapping[str, Any]
Images = Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Scene:
    """One scene of a report. Images are read when they are wanted, a scene at a time.

    Attributes
    ----------
    name, dataset : str
    rows : sequence
        Of the spec ``samples``: of our method, then of each of the others.
    metrics : {name: float}
        The ``scene_metrics`` of our result.
    pictures : function giving {name: uint8 [H, W, 3]}
        The pictures of our result.
    truth : function giving {frame: {query: bool [H, W]}}
    masks : function giving {(protocol, frame, query): bool [H, W]}
        Our masks.
    """

    name: str
    dataset: str
    rows: Sequence[Row]
    metrics: Mapping[str, float]
    pictures: Callable[[], Images]
    truth: Callable[[], Mapping[str, Images]]
    masks: Callable[[], Mapping[tuple[str, str, str], np.ndarray]]


@dataclass(frozen=True)
class Metric:
    """A metric of a scene, and how it is printed."""

    key: str
    title: str
    digits: int
    help: str


METRICS = (
    Metric("iou", "IoU", 3, "mean over queries of one mask each against the labelled mask"),
    Metric("hit_mask", "Point in mask", 2, "share of queries whose point lies on the object"),
    Metric("hit_box", "Point in box", 2, "the same against the object's box, as LERF counts"),
    Metric("hit_peak", "Peak in box", 2, "any of the most relevant pixels, as LangSplat counts"),
    Metric("miou", "mIoU", 3, "all queries compete for each pixel; mean class IoU, whole image"),
    Metric("psnr", "PSNR", 1, "dB, rendered novel view against the photograph"),
    Metric("ssim", "SSIM", 3, "rendered novel view against the photograph"),
    Metric(
        "abs_rel", "Depth abs-rel", 3, "context views, all pixels with true depth; less is better"
    ),
    Metric("delta125", "δ < 1.25", 3, "share of pixels whose depth is within 25 %"),
    Metric("bad2", "bad-2.0", 3, "rectified pairs: share of pixels over 2 px off; less is better"),
    Metric(
        "target_abs_rel", "Novel abs-rel", 3, "depth rendered at the novel view; less is better"
    ),
)


def metrics_table(
    metrics: Mapping[str, Mapping[str, float]],
    scores: Sequence[Mapping[str, Any]] = (),
    title: str = "",
    links: Mapping[str, str] | None = None,
) -> Table:
    """Return a line a scene and one of means, below which are the intervals of ``scores``.

    The mean is over the scenes that have the number, each counting once.

    Parameters
    ----------
    metrics : {scene: {metric: float}}
    scores : rows of the spec ``scores``
        Of the scenes by the protocol of the metrics; other numbers have no interval.
    title : str
    links : {scene: str}, optional
        Ids of the parts of the page that show them.
    """
    shown = [m for m in METRICS if any(m.key in own for own in metrics.values())]
    lines = [
        line_of(
            [
                Cell(scene, link=(links or {}).get(scene, "")),
                *(number(own.get(m.key), m.digits) for m in shown),
            ]
        )
        for scene, own in metrics.items()
    ]
    by_metric = {score["metric"]: score for score in scores if score["threshold"] is None}
    means = [Cell("mean")]
    for m in shown:
        mean = float(np.mean([own[m.key] for own in metrics.values() if m.key in own]))
        below = score_cell(by_metric.get(m.key), m.digits).below
        means.append(Cell(f"{mean:.{m.digits}f}", below))
    columns = [Column("scene", is_text=True), *(Column(m.title, m.help) for m in shown)]
    return Table(tuple(columns), (*lines, Line(tuple(means), style="mean")), title)
