"""One line a scene: what the report and the terminal say of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Metric:
    """A column of the summary: how a scene metric is called and printed."""

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


@dataclass(frozen=True)
class Summary:
    """Scene metrics as text, a dash where a scene has not the number.

    ``means`` give every scene that has a number the same weight, as LangSplat averages its scenes.
    """

    columns: tuple[Metric, ...]
    lines: tuple[tuple[str, ...], ...]
    means: tuple[str, ...]


def summarize(metrics: Sequence[Mapping[str, float]]) -> Summary:
    """The summary of the ``scene_metrics`` of some scenes, in their order."""
    shown = tuple(m for m in METRICS if any(m.key in own for own in metrics))
    lines = tuple(
        tuple(f"{own[m.key]:.{m.digits}f}" if m.key in own else "–" for m in shown)
        for own in metrics
    )
    means = []
    for m in shown:
        values = [own[m.key] for own in metrics if m.key in own]
        means.append(f"{float(np.mean(values)):.{m.digits}f}")
    return Summary(shown, lines, tuple(means))
