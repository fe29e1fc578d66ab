"""Section of a training's report on the history of retrainings, and its plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes

from slgaussian.benchmark.drift import LISTS, find_drifts
from slgaussian.benchmark.reports import model
from slgaussian.benchmark.reports.figures import plot as draw_plot
from slgaussian.benchmark.retrainings import COLUMNS, summaries

SIZE = 7.4, 3.4
"""Size of the plot, inches."""

CAPTION = (
    "IoU of candidates and their rivals on held-out lessons, which change with the corpus, and "
    "intervals"
)

DRIFT_HEADS = ["Quantity", "Median then", "Median now", "Distance", "Low", "High", "Noise", "Drift"]

DRIFT_NOTE = (
    "**Distance**: largest difference of the cumulative distributions over lessons (Kolmogorov and "
    "Smirnov). **Low**, **high**: its bootstrap interval over clips. **Noise**: a random exchange "
    "of clips between the versions exceeds it, in any row, with a chance of 5 % at most."
)


def history_section(history: pa.Table, plot: bytes) -> model.Section:
    """Return the section of a history with a row at least; ``plot`` is :func:`history_plot`."""
    rows = summaries(history)
    picture = model.Picture(model.data_uri(plot, "png"), CAPTION, CAPTION)
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
    return draw_plot(partial(_draw, rows), SIZE, "png")


def _draw(rows: Sequence[Mapping[str, Any]], axes: Axes) -> None:
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
