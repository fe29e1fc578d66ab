"""Report of a training: scores and gains, loss curve, and pictures of labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

from slgaussian.benchmark.pictures import encode_png, paint_labels
from slgaussian.benchmark.reports.model import (
    Block,
    Cell,
    Column,
    Gallery,
    Picture,
    Prose,
    Report,
    Section,
    Table,
    data_uri,
    escape,
)
from slgaussian.benchmark.reports.plots import plot
from slgaussian.benchmark.reports.score_tables import comparison_cell
from slgaussian.benchmark.significance import clip_scores, gain
from slgaussian.benchmark.statistics import LEAST, LEVEL

ABOUT = {
    "hard": "each Gaussian has the object of its own pixel; no network",
    "filled": "as hard, after pixels without an object took one from other views; no network",
    "branch": "the trained branch",
    "before": "the initial weights, or the weights in use",
}
"""Descriptions of the liftings."""

SMOOTH = 0.02
"""Fraction of the steps over which the loss curve is averaged."""


@dataclass(frozen=True, eq=False)
class Example:
    """One target view of a held-out lesson; all pictures are object ids int32 [H, W].

    ``context`` are the labels of the first context view, ``truth`` those of the target, and
    ``predicted`` the result of each lifting, with the IoU of the lesson in ``ious``.
    """

    sample: str
    context: np.ndarray
    truth: np.ndarray
    predicted: Mapping[str, np.ndarray]
    ious: Mapping[str, float]


def training_report(
    metrics: pa.Table,
    judgements: pa.Table,
    examples: Sequence[Example],
    manifest: Mapping[str, Any],
) -> Report:
    """Make the report of a training.

    ``metrics`` and ``judgements`` are tables of these specs; ``manifest`` has the number of lessons
    and the settings, nested mappings allowed.
    """
    caption = "Loss of every step and its running mean; grey: learning rate"
    curve = plot(lambda: _loss_curve(metrics), caption)
    sections = [
        Section("Scores", [scores_table(judgements)]),
        Section("Loss", [Gallery([curve], "grid plots")]),
    ]
    if examples:
        note = (
            "The largest, median and smallest gain of the branch. IoU: mean over all target views "
            "of the lesson."
        )
        blocks: list[Block] = [Prose(note)]
        for example in examples:
            blocks += [Prose(escape(example.sample)), Gallery(_pictures(example), "labels")]
        sections.append(Section("Held-out lessons", blocks))
    sections.append(Section("Configuration", [Table.of_values(manifest)]))
    summary = "Evaluated by the objects in target views of clips that are not in the training set."
    return Report("Training of the semantic branch", [Prose(summary)], sections)


def scores_table(judgements: pa.Table) -> Table:
    """Return the mean IoU of each lifting, and the gain of the branch over it."""
    rows: list[list[Cell | str | None]] = []
    for name, scores in clip_scores(judgements).items():
        cell = None if name == "branch" else comparison_cell(gain(judgements, name), 4)
        rows.append([name, f"{np.mean(scores):.4f}", cell, ABOUT[name]])
    heads = ["Lifting", "IoU", "Branch minus lifting", Column("", is_text=True)]
    note = f"Intervals: {LEVEL:.0%} paired bootstrap over clips; unreliable below {LEAST} clips."
    return Table.of(heads, rows, notes=[note])


def _loss_curve(metrics: pa.Table) -> Figure:
    steps, loss = metrics["step"].to_numpy(), metrics["loss"].to_numpy()
    figure = Figure((7.4, 3.0), layout="constrained")
    axes = figure.subplots()
    width = max(1, round(SMOOTH * len(steps)))
    axes.plot(steps, loss, ".", ms=2, alpha=0.25, color="#12833f")
    smooth = np.convolve(loss, np.ones(width) / width, "valid")
    axes.plot(steps[width - 1 :], smooth, color="#12833f")
    if (loss > 0).any():
        axes.set_yscale("log")
    axes.set(xlabel="step", ylabel="loss")
    rate = axes.twinx()
    rate.plot(steps, metrics["rate"].to_numpy(), color="#b3bac6", lw=1)
    rate.set_ylabel("learning rate", color="#667085")
    rate.set_ylim(0)
    return figure


def _pictures(example: Example) -> list[Picture]:
    images = {
        "context view": example.context,
        "target view": example.truth,
    }
    images |= {
        f"{name}, IoU {example.ious[name]:.3f}": ids for name, ids in example.predicted.items()
    }
    flat = np.full((*example.truth.shape, 3), 170, np.uint8)
    return [
        Picture(data_uri(encode_png(paint_labels(ids, flat)), "png"), caption, caption)
        for caption, ids in images.items()
    ]
