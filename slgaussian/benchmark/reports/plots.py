"""Plots of scores as SVG text that may stand in a page: same numbers, same bytes."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from matplotlib.transforms import Bbox

from slgaussian.benchmark.scores import Reliability

Row = Mapping[str, Any]

NOTES = ("Date", "Creator", "Format", "Type")
"""What Matplotlib would write about itself into a picture."""

INK, SOFT, LINE, ACCENT = "#1d2330", "#667085", "#d5dae2", "#0072B2"
COLORS = ("#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7a5200")
"""Okabe and Ito's colours, which colour-blind people tell apart."""
MARKERS = ("s", "^", "D", "v", "P", "X")

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

NAMED = len(COLORS)
"""Methods beside ours that a plot of lines names; the others are drawn pale."""


def as_svg(draw: Callable[[], Figure]) -> str:
    """The figure that ``draw`` makes as an ``svg`` element for HTML, which needs no namespaces."""
    out = io.StringIO()
    with matplotlib.rc_context(STYLE):
        draw().savefig(out, format="svg", metadata=dict.fromkeys(NOTES))
    text = out.getvalue()
    return re.sub(r' xmlns(:xlink)?="[^"]*"', "", text[text.index("<svg") :])


def plot_curves(curves: Mapping[str, Mapping[float, float]], ours: str) -> str:
    """IoU with each threshold, by method; the best others have a colour and a name."""

    def draw() -> Figure:
        figure = Figure((5.6, 4.2), layout="constrained")
        axes = figure.subplots()
        for method, style in _styles(curves, ours, lambda curve: max(curve.values())):
            curve = curves[method]
            axes.plot(list(curve), list(curve.values()), ms=3.5, **style)
        axes.set(xlim=(0, 1), ylim=(0, None), xlabel="relevancy above which pixels are taken")
        axes.set_ylabel("IoU")
        axes.grid()
        _name_lines(figure)
        return figure

    return as_svg(draw)


def plot_reliability(found: Mapping[str, Reliability], ours: str) -> str:
    """How often the point is right, by how sure each method was; on the diagonal both agree.

    The larger a mark, the more samples; marks of a few samples say little. Other methods are pale.
    """

    def draw() -> Figure:
        figure = Figure((5.6, 4.2), layout="constrained")
        axes = figure.subplots()
        axes.plot((0, 1), (0, 1), color=LINE, lw=1.2, ls="--")
        others = [method for method in found if method != ours]
        for method in [*others, *(found.keys() & {ours})]:
            own = found[method]
            some = own.counts > 0
            fractions = own.hits[some] / own.counts[some]
            means = own.scores[some] / own.counts[some]
            sizes = 4 + 200 * own.counts[some] / own.counts.sum()
            if method == ours:
                axes.plot(means, fractions, color=ACCENT, lw=1.2, alpha=0.5)
                axes.scatter(means, fractions, sizes, color=ACCENT, zorder=3, label=ours)
            else:
                label = "other methods" if method == others[-1] else None
                axes.scatter(means, fractions, sizes, color=LINE, label=label)
        axes.set(xlim=(0, 1), ylim=(-0.03, 1.03), xlabel="best relevancy", ylabel="share of hits")
        axes.grid()
        _name_lines(figure)
        return figure

    return as_svg(draw)


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


def _name_lines(figure: Figure) -> None:
    """A legend below, ours first."""
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(
        handles[::-1],
        names[::-1],
        loc="outside lower center",
        ncols=3,
        frameon=False,
        fontsize=8,
    )


def _styles(
    methods: Mapping[str, Any], ours: str, merit: Callable[[Any], float]
) -> list[tuple[str, dict[str, Any]]]:
    """How each method's line looks, pale ones first: ours, then the best others, are named."""
    others = sorted((m for m in methods if m != ours), key=lambda m: -merit(methods[m]))
    pale = {"color": LINE, "lw": 1, "zorder": 1}
    styles = [(method, pale) for method in others[NAMED:]]
    for k, method in reversed(list(enumerate(others[:NAMED]))):
        named = {"color": COLORS[k], "marker": MARKERS[k], "lw": 1.2, "zorder": 2}
        styles.append((method, named | {"label": method}))
    if ours in methods:
        mine = {"color": ACCENT, "marker": "o", "lw": 2.4, "zorder": 3, "label": ours}
        styles.append((ours, mine))
    return styles
