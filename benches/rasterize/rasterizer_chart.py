"""The picture of ``docs/measured/rasterizer.md``: error and what is drawn, against time."""

import io

import matplotlib
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from benches.common.chart_style import BLUE, FAINT, INK, ORANGE, STYLE
from benches.rasterize.parameter_sweeps import LOOP

OURS, THEIRS = BLUE, ORANGE
HALO = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
GREY_LEVEL = 1 / 255


def picture(
    thresholds: list[dict],
    counts: list[dict],
    resolutions: list[dict],
    channels: list[dict],
) -> bytes:
    """SVG of the rows of ``parameter_sweeps.py``."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10, 8), layout="constrained")
        upper, lower = figure.subfigures(2, 1, height_ratios=(1.15, 1), hspace=0.04)
        draw_cuts(upper.subplots(), thresholds)
        panels = lower.subplots(1, 3, sharey=True, gridspec_kw={"wspace": 0.06})
        sizes = [f"{row['gaussians'] / 1000:,.0f}k" for row in counts]
        draw_times(panels[0], counts, "gaussians", "Gaussians", sizes)
        sizes = [row["size"].replace(" x ", "×") for row in resolutions]
        draw_times(panels[1], resolutions, "pixels", "image size, pixels", sizes)
        sizes = [str(row["channels"]) for row in channels]
        draw_times(panels[2], channels, "channels", "channels", sizes)
        panels[0].set_ylabel("time for a picture, ms")
        panels[0].legend(loc="upper left", frameon=False, labelcolor="linecolor")
        out = io.BytesIO()
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def draw_cuts(axes: Axes, thresholds: list[dict]) -> None:
    points = {row["what"]: (1e3 * row["seconds"], row["greatest"]) for row in thresholds}
    mark_points(axes, {LOOP: points[LOOP]}, THEIRS, "s", left=True)
    presets = {what: at for what, at in points.items() if what.startswith("3dgs")}
    mark_points(axes, presets, OURS, "D")
    cuts = {what: at for what, at in points.items() if "alpha_min" in what}
    mark_points(axes, cuts, OURS, "o")
    axes.axhline(GREY_LEVEL, color=INK, lw=1, ls=(0, (5, 3)), zorder=1)
    axes.annotate(
        "1/255, a grey level", (1, GREY_LEVEL), (0, 4), ha="right",
        xycoords=axes.get_yaxis_transform(), textcoords="offset points",
    )  # fmt: skip
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xmargin(0.1)
    plain_ticks(axes.xaxis, (1, 1.5, 2, 3, 5, 7))
    axes.grid(color=FAINT)
    axes.set_title("Error against time: down and left is better")
    axes.set_xlabel("time for a picture, ms")
    axes.set_ylabel("greatest error of any value in [0, 1]")


def mark_points(
    axes: Axes, points: dict[str, tuple[float, float]], color: str, marker: str, left: bool = False
) -> None:
    """Join the points with a line, and write the name of each beside it."""
    axes.plot(*zip(*points.values(), strict=True), marker=marker, color=color, ms=7)
    for name, at in points.items():
        axes.annotate(
            name, at, (-9 if left else 9, 0), textcoords="offset points", va="center",
            ha="right" if left else "left", color=color, bbox=HALO,
        )  # fmt: skip


def draw_times(axes: Axes, rows: list[dict], key: str, label: str, ticks: list[str]) -> None:
    at = [row[key] for row in rows]
    for name, told, color, marker in (
        ("loop", LOOP, THEIRS, "s"),
        ("fast", "rasterize", OURS, "o"),
    ):
        times = [1e3 * row[name] for row in rows]
        axes.plot(at, times, marker=marker, color=color, ms=6, label=told)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xmargin(0.08)
    axes.xaxis.set_major_locator(FixedLocator(at))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda _, position: ticks[position]))
    axes.xaxis.set_minor_locator(NullLocator())
    plain_ticks(axes.yaxis, (1, 2, 5))
    axes.grid(color=FAINT)
    axes.set_title(f"Time against {label.split(',')[0]}")
    axes.set_xlabel(label)


def plain_ticks(axis: Axis, at: tuple[float, ...]) -> None:
    """Ticks of a log axis at these numbers in every decade, printed plainly."""
    axis.set_major_locator(LogLocator(subs=at))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
    axis.set_minor_locator(NullLocator())
