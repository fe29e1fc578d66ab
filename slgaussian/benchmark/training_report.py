"""What a training leaves to look at: one HTML page with its curves, scores and label pictures.

It depends on its arguments alone: same training, same bytes.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

from slgaussian.benchmark.pictures import encode_png, paint_labels
from slgaussian.benchmark.plots import as_svg
from slgaussian.benchmark.rendering import flatten, template
from slgaussian.benchmark.statistics import LEAST, LEVEL
from slgaussian.benchmark.verdict import clip_scores, gain

ABOUT = {
    "hard": "each Gaussian has the object of its own pixel; no network",
    "filled": "the same, after pixels without an object took one from other views; no network",
    "identity": "the branch before training: equals filled, or hard if it sees single views",
    "branch": "the branch that was trained",
    "before": "the weights that training began from, or that are in use",
}
"""What each lifting is."""

SMOOTH = 0.02
"""Fraction of the steps over which the curve of the loss is averaged."""


@dataclass(frozen=True, eq=False)
class Example:
    """One target view of a held-out lesson, all pictures int32 [H, W] object ids.

    ``shown`` is the first context view as the liftings saw it, ``truth`` the target labels, and
    ``found`` by lifting what was found, with the IoU of the lesson under ``ious``.
    """

    sample: str
    labels: str
    shown: np.ndarray
    truth: np.ndarray
    found: Mapping[str, np.ndarray]
    ious: Mapping[str, float]


def render_training_report(
    metrics: pa.Table,
    judgements: pa.Table,
    examples: Sequence[Example],
    manifest: Mapping[str, Any],
) -> str:
    """One self-contained HTML page: no network, no script, the same bytes from run to run.

    Parameters
    ----------
    metrics, judgements : tables of these specs
    examples : sequence of Example
    manifest : mapping
        Numbers of lessons and settings, nested mappings allowed.
    """
    kinds = list(dict.fromkeys(judgements["labels"].to_pylist()))
    names = list(dict.fromkeys(judgements["lifting"].to_pylist()))
    means = {kind: clip_scores(judgements, kind) for kind in kinds}
    others = [name for name in names if name != "branch"]
    return template("training_report.html.j2").render(
        names=names,
        about=ABOUT,
        kinds=kinds,
        means={k: {n: float(np.mean(own)) for n, own in of.items()} for k, of in means.items()},
        gains={other: {kind: gain(judgements, other, kind) for kind in kinds} for other in others},
        level=LEVEL,
        least=LEAST,
        loss=as_svg(lambda: _loss_curve(metrics)),
        gain_by_clip=as_svg(lambda: _gain_by_clip(judgements, kinds)),
        examples=[_pictures(example) for example in examples],
        manifest=flatten(manifest),
    )


def _loss_curve(metrics: pa.Table) -> Figure:
    steps, loss = metrics["step"].to_numpy(), metrics["loss"].to_numpy()
    figure = Figure((7.4, 3.0), layout="constrained")
    axes = figure.subplots()
    width = max(1, round(SMOOTH * len(steps)))
    for corrupted, colour, name in ((False, "#12833f", "as found"), (True, "#3b5bdb", "corrupted")):
        mine = metrics["corrupted"].to_numpy() == corrupted
        if not mine.any():
            continue
        axes.plot(steps[mine], loss[mine], ".", ms=2, alpha=0.25, color=colour)
        smooth = np.convolve(loss[mine], np.ones(width) / width, "valid")
        axes.plot(steps[mine][width - 1 :], smooth, color=colour, label=f"labels {name}")
    if (loss > 0).any():
        axes.set_yscale("log")
    axes.set(xlabel="step", ylabel="loss")
    axes.legend(frameon=False)
    rate = axes.twinx()
    rate.plot(steps, metrics["rate"].to_numpy(), color="#b3bac6", lw=1)
    rate.set_ylabel("learning rate", color="#667085")
    rate.set_ylim(0)
    return figure


def _gain_by_clip(judgements: pa.Table, kinds: Sequence[str]) -> Figure:
    figure = Figure((7.4, 3.0), layout="constrained")
    axes = figure.subplots()
    for kind, colour in zip(kinds, ("#12833f", "#3b5bdb"), strict=False):
        scores = clip_scores(judgements, kind)
        axes.plot(scores["hard"], scores["branch"], ".", color=colour, label=f"labels {kind}")
    low, high = axes.get_xlim()
    axes.plot((low, high), (low, high), color="#b3bac6", lw=1, zorder=0)
    axes.set(xlabel="IoU of hard", ylabel="IoU of branch")
    axes.legend(frameon=False)
    return figure


def _pictures(example: Example) -> dict[str, Any]:
    def picture(ids: np.ndarray) -> str:
        flat = np.full((*ids.shape, 3), 170, np.uint8)
        data = encode_png(paint_labels(ids, flat))
        return f"data:image/png;base64,{base64.b64encode(data).decode()}"

    captions = {name: f"{name}, IoU {example.ious[name]:.3f}" for name in example.found}
    tiles = {f"a context view, labels {example.labels}": example.shown}
    tiles |= {"a target view": example.truth}
    tiles |= {captions[name]: ids for name, ids in example.found.items()}
    return {
        "sample": example.sample,
        "tiles": {caption: picture(ids) for caption, ids in tiles.items()},
    }
