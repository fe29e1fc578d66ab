"""Report of a training: scores and gains, and the loss curve."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes

from slgaussian.benchmark.reports import model
from slgaussian.benchmark.reports.figures import ACCENT_COLOUR, MUTED_COLOUR, svg_picture
from slgaussian.benchmark.reports.score_tables import comparison_cell
from slgaussian.benchmark.significance import clip_scores, gain
from slgaussian.benchmark.statistics import CONFIDENCE_LEVEL, MIN_SAMPLES

LIFTING_DESCRIPTIONS = {
    "hard": "each Gaussian has the object of its own pixel; no network",
    "filled": "as hard, after pixels without an object took one from other views; no network",
    "branch": "the trained branch",
    "before": "the initial weights, or the weights in use",
}
"""Descriptions of the liftings."""

SMOOTHING_SHARE = 0.02
"""Fraction of the steps over which the loss curve is averaged."""


def training_report(
    metrics: pa.Table, judgements: pa.Table, manifest: Mapping[str, Any]
) -> model.Report:
    """Make the report of a training.

    ``metrics`` and ``judgements`` are tables of these specs; ``manifest`` has the number of lessons
    and the settings, nested mappings allowed.
    """
    rows = [
        [
            name,
            f"{np.mean(scores):.4f}",
            None if name == "branch" else comparison_cell(gain(judgements, name), 4),
            LIFTING_DESCRIPTIONS[name],
        ]
        for name, scores in clip_scores(judgements).items()
    ]
    heads = ["Lifting", "IoU", "Branch minus lifting", model.Column("", is_text=True)]
    note = (
        f"Intervals: {CONFIDENCE_LEVEL:.0%} paired bootstrap over clips; unreliable below "
        f"{MIN_SAMPLES} clips."
    )
    caption = "Loss of every step and its running mean; grey: learning rate"
    curve = svg_picture(partial(_draw_loss, metrics), (7.4, 3.0), caption)
    sections = [
        model.Section("Scores", [model.Table(heads, rows, notes=[note])]),
        model.Section("Loss", [model.Gallery([curve], "grid plots")]),
        model.Section("Configuration", [model.values_table(manifest)]),
    ]
    summary = "Evaluated by the objects in target views of clips that are not in the training set."
    return model.Report("Training of the semantic branch", [model.Prose(summary)], sections)


def _draw_loss(metrics: pa.Table, axes: Axes) -> None:
    steps, loss = metrics["step"].to_numpy(), metrics["loss"].to_numpy()
    width = max(1, round(SMOOTHING_SHARE * len(steps)))
    axes.plot(steps, loss, ".", ms=2, alpha=0.25, color=ACCENT_COLOUR)
    axes.plot(
        steps[width - 1 :], np.convolve(loss, np.ones(width) / width, "valid"), color=ACCENT_COLOUR
    )
    if (loss > 0).any():
        axes.set_yscale("log")
    axes.set(xlabel="step", ylabel="loss")
    rate = axes.twinx()
    rate.plot(steps, metrics["rate"].to_numpy(), color=MUTED_COLOUR, lw=1)
    rate.set_ylabel("learning rate", color=MUTED_COLOUR)
    rate.set_ylim(0)
