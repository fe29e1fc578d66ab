"""Report of a training: scores and gains, the loss curve, and the history of retrainings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes

from slgaussian.benchmark.drift import LISTS, find_drifts
from slgaussian.benchmark.reports import model
from slgaussian.benchmark.reports.figures import ACCENT_COLOUR, MUTED_COLOUR, plot, svg_picture
from slgaussian.benchmark.reports.score_tables import comparison_cell
from slgaussian.benchmark.retrainings import COLUMNS, summaries
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

HISTORY_CAPTION = (
    "IoU of candidates and their rivals on held-out lessons, which change with the corpus, and "
    "intervals"
)

DRIFT_HEADS = ["Quantity", "Median then", "Median now", "Distance", "Low", "High", "Noise", "Drift"]

DRIFT_NOTE = (
    "**Distance**: largest difference of the cumulative distributions over lessons (Kolmogorov and "
    "Smirnov). **Low**, **high**: its bootstrap interval over clips. **Noise**: a random exchange "
    "of clips between the versions exceeds it, in any row, with a chance of 5 % at most."
)


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


def history_section(history: pa.Table, png: bytes) -> model.Section:
    """Return the section of a history with a row at least; ``png`` is :func:`history_plot`."""
    rows = summaries(history)
    picture = model.Picture(model.data_uri(png, "png"), HISTORY_CAPTION, HISTORY_CAPTION)
    blocks: list[model.Block] = [
        model.Gallery([picture], "grid plots"),
        model.Table(list(rows[0]), (row.values() for row in rows)),
    ]
    last = history.to_pylist()[-1]
    if last["against"]:
        names, *numbers = (last[name] for name in LISTS)
        answers = ["yes" if name in find_drifts(last) else "no" for name in names]
        texts = ([f"{value:.3g}" for value in column] for column in numbers)
        title = f"Drift of the lessons against those of version {last['against']}"
        lines = zip(names, *texts, answers, strict=True)
        blocks.append(model.Table(DRIFT_HEADS, lines, title, [DRIFT_NOTE]))
    return model.Section("Retrainings", blocks, "retrainings")


def history_plot(history: pa.Table) -> bytes:
    """Return a plot of the scores of all candidates as the bytes of a PNG file."""
    rows = [row for row in history.to_pylist() if row["candidate_iou"] is not None]
    return plot(partial(_draw_history, rows), (7.4, 3.4), "png")


def _draw_history(rows: Sequence[Mapping[str, Any]], axes: Axes) -> None:
    for name in COLUMNS.values():
        known = [(x, row) for x, row in enumerate(rows) if row[f"{name}_iou"] is not None]
        ious = [row[f"{name}_iou"] for _, row in known]
        (line,) = axes.plot([x for x, _ in known], ious, ".-", lw=1, label=name)
        for x, row in known:
            if row[f"{name}_low"] is not None:
                ends = row[f"{name}_low"], row[f"{name}_high"]
                axes.vlines(x, *ends, color=line.get_color(), alpha=0.4)
    promoted = [
        (x, row["candidate_iou"]) for x, row in enumerate(rows) if row["outcome"] == "promoted"
    ]
    axes.plot(*np.reshape(promoted, (-1, 2)).T, "o", ms=9, mfc="none", color="C0", label="promoted")
    axes.set_xticks(range(len(rows)), [str(row["version"]) for row in rows])
    axes.set(xlabel="version", ylabel="IoU")
    axes.grid()
    axes.legend(frameon=False, fontsize=8.5)
