"""What more photographs are worth: the same targets by the number of context views.

A row of the spec ``view_counts`` is a scene with one number of context views. Only scenes that have
a row of every number count, so that all numbers are of the same targets; gains are over the least
number, in pairs of scenes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from slgaussian.benchmark.plots import ACCENT, LINE, as_svg
from slgaussian.benchmark.rendering import template
from slgaussian.benchmark.report import Report
from slgaussian.benchmark.score_tables import NOTHING, Cell
from slgaussian.benchmark.scores import place_of
from slgaussian.benchmark.statistics import LEAST, LEVEL, compare
from slgaussian.benchmark.summary import METRICS, Metric

Row = Mapping[str, Any]

LESS_IS_BETTER = {"target_abs_rel", "abs_rel"}
SHOWN = ("psnr", "ssim", "target_abs_rel", "abs_rel", "iou", "miou", "hit_mask")
"""Columns of the spec that are scores, those of the pictures first."""

PLOTTED = ("psnr", "target_abs_rel", "iou")
COLUMNS = tuple(metric for key in SHOWN for metric in METRICS if metric.key == key)


@dataclass(frozen=True)
class Line:
    """One number of views: mean scores with their gains, and what a scene costs.

    Attributes
    ----------
    views : int
    cells : tuple of Cell
        By the columns of the table.
    gaussians, grown : float
        Mean of those predicted, and how many times those of the least number.
    kept : float
        Mean of those that a field has of them.
    seconds : float
        Median: the first scenes may have waited for kernels.
    """

    views: int
    cells: tuple[Cell, ...]
    gaussians: float
    grown: float
    kept: float
    seconds: float


@dataclass(frozen=True)
class Counts:
    """A data set by the number of views.

    ``scenes`` are those that have every number, of ``places`` different places.
    """

    dataset: str
    scenes: int
    places: int
    columns: tuple[Metric, ...]
    lines: tuple[Line, ...]


Seconds = Mapping[tuple[str, int], float]
"""Of building the field of a scene from a number of views."""


def counts_of(rows: Sequence[Row], seconds: Seconds) -> list[Counts]:
    """The table of each data set that has a scene with all numbers, numbers ascending."""
    return [_counts(dataset, own, seconds) for dataset, own in _by_dataset(rows).items()]


def render_view_counts(
    rows: Sequence[Row], seconds: Seconds, failures: Sequence[Mapping[str, str]], said: str
) -> Report:
    """The page, without network and script, and the same as Markdown.

    Parameters
    ----------
    rows : sequence
        Of the spec ``view_counts``.
    seconds : {(scene, views): float}
    failures : sequence of mapping
        Scenes left out: ``scene``, ``stage``, ``reason``.
    said : str
        How the fields were built, in a line.
    """
    own = _by_dataset(rows)
    shown = {
        "tables": counts_of(rows, seconds),
        "failures": failures,
        "said": said,
        "numbers": sorted({row["views"] for row in rows}),
        "folder": folder,
        "level": LEVEL,
        "least": LEAST,
    }
    charts = {
        dataset: [_error_chart(known), _cost_chart(known, seconds)]
        for dataset, known in own.items()
    }
    html = template("view_counts.html.j2").render(**shown, charts=charts)
    return Report(html, template("view_counts.md.j2").render(**shown))


def folder(views: int) -> str:
    """Where the report of one number is, below that of all."""
    return f"views_{views}"


def _by_dataset(rows: Sequence[Row]) -> dict[str, dict[int, list[Row]]]:
    """Rows by data set and number, of the scenes that have all numbers, in one order."""
    numbers = sorted({row["views"] for row in rows})
    found: dict[str, dict[int, list[Row]]] = {}
    for dataset in dict.fromkeys(row["dataset"] for row in rows):
        by_scene: dict[str, dict[int, Row]] = {}
        for row in rows:
            if row["dataset"] == dataset:
                by_scene.setdefault(row["scene"], {})[row["views"]] = row
        whole = [own for own in by_scene.values() if len(own) == len(numbers)]
        if whole:
            found[dataset] = {number: [own[number] for own in whole] for number in numbers}
    return found


def _counts(dataset: str, own: Mapping[int, Sequence[Row]], seconds: Seconds) -> Counts:
    least = own[min(own)]
    columns = _known(least)
    gaussians = {
        number: float(np.mean([row["gaussians"] for row in own[number]])) for number in own
    }
    lines = (
        Line(
            number,
            tuple(_cell(column, rows, least) for column in columns),
            gaussians[number],
            gaussians[number] / max(gaussians[min(own)], 1),
            float(np.mean([row["kept"] for row in rows])),
            median(seconds[row["scene"], number] for row in rows),
        )
        for number, rows in own.items()
    )
    return Counts(dataset, len(least), len(set(map(place_of, least))), columns, tuple(lines))


def _known(rows: Sequence[Row]) -> tuple[Metric, ...]:
    """The columns that some row has."""
    return tuple(c for c in COLUMNS if any(row[c.key] is not None for row in rows))


def _cell(column: Metric, rows: Sequence[Row], least: Sequence[Row]) -> Cell:
    """The mean, the gain over the least number, and the worst gain of a scene."""
    known = [
        (row[column.key], other[column.key], place_of(row))
        for row, other in zip(rows, least, strict=True)
        if None not in (row[column.key], other[column.key])
    ]
    if not known:
        return NOTHING
    values, others, places = (list(each) for each in zip(*known, strict=True))
    value = f"{np.mean(values):.{column.digits}f}"
    if rows is least:
        return Cell(value)
    sign = -1 if column.key in LESS_IS_BETTER else 1
    gain = compare(values, others, groups=places)
    worst = sign * min(sign * (a - b) for a, b in zip(values, others, strict=True))
    digits = column.digits + 1
    said = f"{gain.difference:+.{digits}f}"
    if gain.drawn > 1:
        said += f" ({gain.low:+.{digits}f} to {gain.high:+.{digits}f})"
    good, bad = (gain.low > 0, gain.high < 0)[::sign]
    mark = "few" if gain.drawn < LEAST else "better" if good else "worse" if bad else "noise"
    return Cell(value, f"{said}, worst {worst:+.{digits}f}", mark)


def _error_chart(own: Mapping[int, Sequence[Row]]) -> str:
    """Scores against the number of views: the mean, and every scene pale."""
    least = own[min(own)]
    shown = [
        c for c in COLUMNS if c.key in PLOTTED and any(row[c.key] is not None for row in least)
    ]

    def draw() -> Figure:
        figure = Figure((3.2 * len(shown), 2.7), layout="constrained")
        for axes, column in zip(
            figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True
        ):
            values = [[_number(row[column.key]) for row in rows] for rows in own.values()]
            _draw(axes, list(own), np.array(values), column.title)
        return figure

    return as_svg(draw)


def _cost_chart(own: Mapping[int, Sequence[Row]], seconds: Seconds) -> str:
    """Gaussians and seconds against the number of views."""
    made = [[row["gaussians"] / 1000 for row in rows] for rows in own.values()]
    took = [[seconds[row["scene"], number] for row in rows] for number, rows in own.items()]

    def draw() -> Figure:
        figure = Figure((6.4, 2.7), layout="constrained")
        for axes, values, title in zip(
            figure.subplots(1, 2), (made, took), ("Gaussians, thousands", "seconds to build"),
            strict=True,
        ):  # fmt: skip
            _draw(axes, list(own), np.array(values), title)
            axes.set_ylim(0)
        return figure

    return as_svg(draw)


def _draw(axes: Axes, numbers: Sequence[int], values: np.ndarray, title: str) -> None:
    """float [numbers, scenes] over the numbers of views."""
    axes.plot(numbers, values, color=LINE, lw=1)
    known = ~np.isnan(values).any(0)
    if known.any():
        axes.plot(numbers, values[:, known].mean(1), "o-", color=ACCENT, lw=2.2, ms=5)
    axes.set(xlabel="context views", title=title, xticks=numbers)
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.grid()


def _number(value: float | None) -> float:
    return np.nan if value is None else value
