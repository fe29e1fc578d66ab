"""Plots of scores as SVG text that may stand in a page: same numbers, same bytes."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Sequence

import matplotlib
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from matplotlib.transforms import Bbox

NOTES = ("Date", "Creator", "Format", "Type")
"""What Matplotlib would write about itself into a picture."""

INK, SOFT, LINE, ACCENT = "#1d2330", "#667085", "#d5dae2", "#0072B2"

STYLE = {
    "svg.hashsalt": "slgaussian",
    "svg.fonttype": "path",
    "font.size": 9.5,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": LINE,
    "xtick.color": SOFT,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": "#eef0f4",
}

NAMED = 6
"""Methods up to which all are named in a plot; of more, ours and those on the front."""


def as_svg(draw: Callable[[], Figure]) -> str:
    """The figure that ``draw`` makes as an ``svg`` element for HTML, which needs no namespaces."""
    out = io.StringIO()
    with matplotlib.rc_context(STYLE):
        draw().savefig(out, format="svg", metadata=dict.fromkeys(NOTES))
    text = out.getvalue()
    return re.sub(r' xmlns(:xlink)?="[^"]*"', "", text[text.index("<svg") :])


def plot_worth(
    points: Sequence[tuple[str, float, float]], ours: str, label: str, score: str = "IoU"
) -> str:
    """Draw a score over its cost, the best of each price joined: the Pareto front.

    ``points`` are (method, score, cost); those on the front are named, and all where they are few,
    but none whose name would lie on another.
    """

    def draw() -> Figure:
        figure = Figure((5.6, 4.2), layout="constrained")
        axes = figure.subplots()
        best, front = -math.inf, []
        for _, value, cost in sorted(points, key=lambda point: (point[2], -point[1])):
            if value > best:
                best = value
                front.append((cost, value))
        axes.plot(*zip(*front, strict=True), color=SOFT, lw=0.8, drawstyle="steps-post", zorder=1)
        for method, value, cost in points:
            color, size = (ACCENT, 8) if method == ours else (SOFT, 5.5)
            axes.plot(cost, value, "o", color=color, ms=size, mec="white")
        axes.set(xscale="log", xlabel=label, ylabel=score)
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.margins(0.12, 0.14)
        axes.grid()
        named = [
            point
            for point in sorted(points, key=lambda point: (point[0] != ours, -point[1]))
            if len(points) <= NAMED or point[0] == ours or (point[2], point[1]) in front
        ]
        _name_points(figure, named)
        return figure

    return as_svg(draw)


def _name_points(figure: Figure, points: Sequence[tuple[str, float, float]]) -> None:
    """Write names beside their points, the first ones first; one without room is left out."""
    axes, taken = figure.axes[0], list[Bbox]()
    figure.draw_without_rendering()  # so that places on the page are known
    room = axes.get_window_extent()
    for name, value, cost in points:
        for side, x, y in (("left", 6, 5), ("left", 6, -13), ("right", -6, 5), ("right", -6, -13)):
            text = axes.annotate(name, (cost, value), (x, y), textcoords="offset points", ha=side)
            box = text.get_window_extent()
            if room.x0 <= box.x0 and box.x1 <= room.x1 and not box.count_overlaps(taken):
                taken.append(box)
                break
            text.remove()
