"""Section of a training's report on the history of retrainings, and its plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from matplotlib.axes import Axes

from slgaussian.benchmark.drift import drifted
from slgaussian.benchmark.reports import model
from slgaussian.benchmark.reports.figures import COLOURS, png_bytes
from slgaussian.benchmark.retrainings import COLUMNS, History

SIZE = 7.4, 3.4
"""Size of the plot, inches."""

MAX_ROWS = 10
"""Largest number of retrainings in the table."""

CAPTION = (
    "IoU of candidates and their rivals on held-out lessons, which change with the corpus, and "
    "intervals; a filled circle is a promotion"
)

DRIFT_NOTE = (
    "**Distance**: largest difference of the cumulative distributions over lessons (Kolmogorov and "
    "Smirnov), with a bootstrap interval over clips. **Noise**: a random exchange of clips between "
    "the two versions exceeds it, in any row, with a chance of 5 % at most."
)


def history_section(history: History, plot: bytes) -> model.Section:
    """Return the section of a history with a row at least; ``plot`` is :func:`history_plot`."""
    summaries = history.summaries(MAX_ROWS)
    picture = model.Picture(model.data_uri(plot, "png"), CAPTION, CAPTION)
    rows = [list(summary.values()) for summary in summaries]
    blocks: list[model.Block] = [
        model.Gallery([picture], "grid plots"),
        model.Table(list(summaries[0]), rows),
    ]
    last = history.table.to_pylist()[-1]
    if last["against"]:
        title = f"Drift of the lessons against those of version {last['against']}"
        heads = ["Quantity", "Median then", "Median now", "Distance", "Noise", "Beyond noise"]
        blocks.append(model.Table(heads, _drift_rows(last), title, [DRIFT_NOTE]))
    return model.Section("Retrainings", blocks, "retrainings")


def _drift_rows(row: dict[str, Any]) -> list[list[model.Cell | str]]:
    beyond, lines = drifted(row), []
    for place, name in enumerate(row["quantities"]):
        numbers = (row[c][place] for c in ("medians_then", "medians_now", "drifts", "noises"))
        then, now, drift, noise = numbers
        ends = f"{row['drift_lows'][place]:.3f}–{row['drift_highs'][place]:.3f}"
        distance = model.Cell(f"{drift:.3f}", ends)
        answer = "yes" if name in beyond else "no"
        lines.append(
            [name.replace("_", " "), f"{then:.3g}", f"{now:.3g}", distance, f"{noise:.3f}", answer]
        )
    return lines


def history_plot(history: History) -> bytes:
    """Return a plot of the scores of all candidates as the bytes of a PNG file."""
    rows = [row for row in history.table.to_pylist() if row["candidate_iou"] is not None]
    return png_bytes(partial(_draw, rows), SIZE)


def _draw(rows: Sequence[Mapping[str, Any]], axes: Axes) -> None:
    for colour, name in zip(COLOURS, COLUMNS.values(), strict=False):
        known = [(x, row) for x, row in enumerate(rows) if row[f"{name}_iou"] is not None]
        ious = [row[f"{name}_iou"] for _, row in known]
        axes.plot([x for x, _ in known], ious, ".-", color=colour, lw=1, label=name)
        for x, row in known:
            if row[f"{name}_low"] is not None:
                axes.vlines(x, row[f"{name}_low"], row[f"{name}_high"], color=colour, alpha=0.4)
            if name == "candidate" and row["outcome"] == "promoted":
                axes.plot(x, row["candidate_iou"], "o", color=colour, ms=9)
    axes.set_xticks(range(len(rows)), [str(row["version"]) for row in rows])
    axes.set(xlabel="version", ylabel="IoU")
    axes.grid()
    axes.legend(frameon=False, fontsize=8.5)
