"""The picture of ``docs/measured/codes.md``."""

import io

import matplotlib
import matplotlib.ticker
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benches.common.chart_style import BLUE, FAINT, GREEN, ORANGE, STYLE

COLOURS = {"exact": GREEN, "grid": ORANGE, "separated": BLUE}
MARKERS = {3: "o", 2: "s", 1: "^"}
WINDOW = np.s_[120:330, 150:430]


def picture(
    errors: list[dict], times: list[dict], crops: dict[str, tuple[np.ndarray, np.ndarray]]
) -> bytes:
    """PNG: errors over objects and over time, and a part of one view."""
    with matplotlib.rc_context({**STYLE, "font.size": 9, "axes.titlesize": 10}):
        figure = Figure(figsize=(11, 6.6), layout="constrained", dpi=100)
        upper, lower = figure.subfigures(2, 1, height_ratios=(1.6, 1))
        left, middle, right = upper.subplots(1, 3)
        _draw_counts(left, errors, "plain", "Nearest code alone: wrong pixels")
        _draw_counts(middle, errors, "wrong", "With a look at neighbours")
        middle.sharey(left)
        _draw_times(right, errors, times)
        _draw_crops(lower, crops)
        out = io.BytesIO()
        figure.savefig(out, format="png", metadata={"Software": None})
    return out.getvalue()


def _draw_counts(axes: Axes, errors: list[dict], key: str, title: str) -> None:
    for method in dict.fromkeys(row["method"] for row in errors):
        name, _, dimension = method.partition(", ")
        mine = [row for row in errors if row["method"] == method]
        axes.plot(
            [row["objects"] for row in mine], [100 * row[key] for row in mine],
            color=COLOURS[name], marker=MARKERS[int(dimension or 3)], ms=5,
            ls="-" if dimension in ("", "3") else ":", label=method,
        )  # fmt: skip
    axes.set_xscale("log")
    axes.set_xticks([row["objects"] for row in errors if row["method"] == "exact"])
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:.0f}")
    axes.xaxis.set_minor_locator(matplotlib.ticker.NullLocator())
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.grid(color=FAINT)
    axes.set_title(title)
    axes.set_xlabel("objects")
    axes.set_ylabel("per cent")
    if key == "plain":
        axes.legend(frameon=False, fontsize=8)


def _draw_times(axes: Axes, errors: list[dict], times: list[dict]) -> None:
    objects = min({row["objects"] for row in errors}, key=lambda n: abs(n - 60))
    spent = {row["method"]: row for row in times}
    for row in errors:
        if row["objects"] != objects:
            continue
        name, _, dimension = row["method"].partition(", ")
        at = 1e3 * spent[row["method"]]["both"], 100 * row["wrong"]
        axes.plot(*at, color=COLOURS[name], marker=MARKERS[int(dimension or 3)], ms=7)
    axes.margins(0.12, 0.12)
    axes.set_xlim(left=0)
    axes.grid(color=FAINT)
    axes.set_title("Error against time, 60 objects")
    axes.set_xlabel("draw and read a view, ms of one core")
    axes.set_ylabel("wrong pixels, per cent")


def _draw_crops(figure: Figure, crops: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    colours = np.random.default_rng(3).uniform(0.45, 1, (1024, 3))
    colours[0] = 0
    for axes, (name, (ids, wrong)) in zip(
        figure.subplots(1, len(crops)), crops.items(), strict=True
    ):
        shown = np.where(wrong[..., None], (0.85, 0, 0), colours[ids % len(colours)])
        axes.imshow(shown[WINDOW], interpolation="nearest")
        axes.set_axis_off()
        axes.set_title(name, fontsize=9)
