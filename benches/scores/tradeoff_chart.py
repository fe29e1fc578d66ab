"""The chart of ``docs/measured/tradeoffs.md``."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from benches.common.chart_style import BLUE, FAINT, GREEN, INK, ORANGE, PINK, STYLE
from benches.scores.tradeoff_summary import NOISE, picked, summaries

LOOKS = {
    "size": (BLUE, "o"),
    "depth candidates": (ORANGE, "s"),
    "Gaussians": ("#000000", "h"),
    "replicas": (PINK, "v"),
    "codes": (GREEN, "D"),
    "lifting": ("#56B4E9", "^"),
    "together": ("#7a5200", "X"),
    "precision": ("#E69F00", "P"),
    NOISE: ("#999999", "."),
}
"""Colour and marker of a factor."""


LABELS = {
    "fast": ((9, -5), "left"),
    "balanced": ((-8, -15), "right"),
}
"""Where the name of a preset stands beside its star, points, and how it is aligned."""


def chart(made: Sequence[dict]) -> bytes:
    """SVG: what every row is worth, over what it costs, with the best of each price joined."""
    rows = summaries(made)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10.5, 4.4), layout="constrained")
        iou, depth, memory = figure.subplots(1, 3)
        draw(iou, rows, "build", "iou", most=True)
        iou.set(title="Query IoU", xlabel="seconds of the processor to build")
        draw(depth, rows, "build", "abs_rel", most=False)
        depth.set(title="Depth error", xlabel="seconds of the processor to build")
        draw(memory, rows, "memory", "iou", most=True)
        memory.set(title="Query IoU", xlabel="memory, MB")
        figure.legend(
            *iou.get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False
        )
        out = io.BytesIO()
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def draw(axes: Axes, rows: Sequence[dict], x: str, y: str, most: bool) -> None:
    axes.grid(color=FAINT)
    axes.margins(0.09, 0.12)
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 5, 7)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    front = best_by_price(rows, x, y, max if most else min)
    axes.plot(*zip(*front, strict=True), color=INK, lw=0.8, drawstyle="steps-post", label="front")
    for factor, (color, marker) in LOOKS.items():
        own = [(row[x], row[y]) for row in rows if row["factor"] == factor]
        if own:
            axes.scatter(*zip(*own, strict=True), color=color, marker=marker, s=28, label=factor)
    for name, row in picked(rows).items():
        axes.scatter(row[x], row[y], color=INK, marker="*", s=110, zorder=3)
        beside, side = LABELS[name]
        axes.annotate(
            name, (row[x], row[y]), beside, textcoords="offset points", ha=side, zorder=4,
            bbox={"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.8},
        )  # fmt: skip


def best_by_price(
    rows: Sequence[dict], x: str, y: str, better: Callable[[float, float], float]
) -> list[tuple[float, float]]:
    """The Pareto front: what is better than everything that costs as much or less."""
    front: list[tuple[float, float]] = []
    for price, worth in sorted((row[x], row[y]) for row in rows):
        if not front or (worth != front[-1][1] and better(worth, front[-1][1]) == worth):
            front.append((price, worth))
    return front
