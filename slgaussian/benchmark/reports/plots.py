"""Plots as reproducible SVG pictures: same numbers, same bytes."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Mapping, Sequence

import matplotlib
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from slgaussian.benchmark.reports.model import Picture, data_uri

METADATA = ("Date", "Creator", "Format", "Type")
"""Metadata keys of Matplotlib that are removed from a picture."""

SOFT, ACCENT = "#667085", "#0072B2"

STYLE = {
    "svg.hashsalt": "slgaussian",
    "svg.fonttype": "path",
    "font.size": 9.5,
    "axes.edgecolor": "#d5dae2",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": "#eef0f4",
}

MARKERS = "osD^v<>pPXhd8"
"""Marker shapes of the methods, in their order."""


def plot(draw: Callable[[], Figure], caption: str) -> Picture:
    """Return the figure that ``draw`` makes as an SVG picture."""
    out = io.StringIO()
    with matplotlib.rc_context(STYLE):
        draw().savefig(out, format="svg", metadata=dict.fromkeys(METADATA))
    text = re.sub(r"<!DOCTYPE[^>]*>\s*", "", out.getvalue(), flags=re.DOTALL)
    return Picture(data_uri(text.encode(), "svg+xml"), caption, caption)


def plot_pareto(
    points: Mapping[str, tuple[float, float]],
    front: Sequence[tuple[float, float]],
    label: str,
    score: str,
) -> Picture:
    """Plot (cost, score) by method; a line connects the Pareto front."""

    def draw() -> Figure:
        figure = Figure((6.6, 3.4 + 0.1 * len(points)), layout="constrained")
        axes = figure.subplots()
        axes.plot(*zip(*sorted(front), strict=True), color=SOFT, lw=0.8, drawstyle="steps-post")
        for place, (method, point) in enumerate(points.items()):
            axes.plot(*point, MARKERS[place % len(MARKERS)], ms=8, mec="white", label=method)
        axes.set(xscale="log", xlabel=label, ylabel=score)
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.margins(0.08, 0.1)
        axes.grid()
        figure.legend(loc="outside lower center", ncols=2, frameon=False)
        return figure

    return plot(draw, f"{score} against {label}; the line is the Pareto front")
