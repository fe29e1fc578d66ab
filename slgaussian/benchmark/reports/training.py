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

    ``context`` is the first context view as input of the liftings, ``truth`` the target labels, and
    ``predicted`` the result of each lifting, with the IoU of the lesson in ``ious``.
    """

    sample: str
    labels: str
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
            "Corrupted labels; the largest, median and smallest gain of the branch. IoU: mean over "
            "all target views of the lesson."
        )
        blocks: list[Block] = [Prose(note)]
        for example in examples:
            blocks += [Prose(escape(example.sample)), Gallery(_pictures(example), "labels")]
        sections.append(Section("Held-out lessons", blocks))
    sections.append(Section("Configuration", [Table.of_values(manifest)]))
    summary = "Evaluated by the objects in target views of clips that are not in the training set."
    return Report("Training of the semantic branch", [Prose(summary)], sections)


def scores_table(judgements: pa.Table) -> Table:
    """Return the mean IoU of each lifting by kind of labels, and the gain of the branch over it."""
    kinds = list(dict.fromkeys(judgements["labels"].to_pylist()))
    scores = {kind: clip_scores(judgements, kind) for kind in kinds}
    rows = []
    for name in dict.fromkeys(judgements["lifting"].to_pylist()):
        row: list[Cell | str | None] = [name]
        for kind in kinds:
            cell = comparison_cell(gain(judgements, name, kind), 4)
            row += [f"{np.mean(scores[kind][name]):.4f}", None if name == "branch" else cell]
        rows.append([*row, ABOUT[name]])
    heads = [head for kind in kinds for head in (f"IoU, labels {kind}", "Branch minus lifting")]
    note = f"Intervals: {LEVEL:.0%} paired bootstrap over clips; unreliable below {LEAST} clips."
    return Table.of(["Lifting", *heads, Column("", is_text=True)], rows, notes=[note])


def _loss_curve(metrics: pa.Table) -> Figure:
    steps, loss = metrics["step"].to_numpy(), metrics["loss"].to_numpy()
    figure = Figure((7.4, 3.0), layout="constrained")
    axes = figure.subplots()
    width = max(1, round(SMOOTH * len(steps)))
    for corrupted, colour, name in ((False, "#12833f", "as found"), (True, "#3b5bdb", "corrupted")):
        chosen = metrics["corrupted"].to_numpy() == corrupted
        if not chosen.any():
            continue
        axes.plot(steps[chosen], loss[chosen], ".", ms=2, alpha=0.25, color=colour)
        smooth = np.convolve(loss[chosen], np.ones(width) / width, "valid")
        axes.plot(steps[chosen][width - 1 :], smooth, color=colour, label=f"labels {name}")
    if (loss > 0).any():
        axes.set_yscale("log")
    axes.set(xlabel="step", ylabel="loss")
    axes.legend(frameon=False)
    rate = axes.twinx()
    rate.plot(steps, metrics["rate"].to_numpy(), color="#b3bac6", lw=1)
    rate.set_ylabel("learning rate", color="#667085")
    rate.set_ylim(0)
    return figure


def _pictures(example: Example) -> list[Picture]:
    images = {
        f"context view, labels {example.labels}": example.context,
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
