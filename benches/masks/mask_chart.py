"""The pictures of ``docs/measured/masks.md``: pairs with their ids, and a chart of the tables."""

import io

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from benches.common.chart_style import BLUE, FAINT, GREEN, STYLE
from benches.masks.id_consistency import OVERLAPS
from slgaussian.labels import LabelMaps
from slgaussian.scene import Sample

COLORS = {"geometric": BLUE, "noisy": GREEN}
MARKERS = {"geometric": "o", "noisy": "^"}
GAP = 6


def pairs_picture(pictured: list[tuple[Sample, dict[str, LabelMaps]]]) -> Image.Image:
    """A row for each view: photograph, true ids where known, and ids by each tracker."""
    colors = np.random.default_rng(5).integers(50, 256, (4096, 3)).astype(np.uint8)
    colors[0] = 0
    pairs = []
    for sample, shown in pictured:
        columns = [[view.image for view in sample.context]]
        if all(view.instances is not None for view in sample.context):
            columns.append([colors[view.instances] for view in sample.context])
        columns += [[colors[labels] for labels in maps.labels] for maps in shown.values()]
        pairs.append(np.concatenate([np.concatenate(column) for column in columns], 1))
    between = np.full((GAP, pairs[0].shape[1], 3), 255, np.uint8)
    rows = [part for pair in pairs for part in (pair, between)][:-1]
    return Image.fromarray(np.concatenate(rows)).reduce(3)


def chart(rows: dict[str, list[dict]]) -> bytes:
    """SVG of the rows of ``id_consistency.py``."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10, 7), layout="constrained")
        (baseline, overlap), (copies, time) = figure.subplots(2, 2)
        draw_lines(baseline, rows["baselines"], "baseline", "matched")
        baseline.set(title="Objects matched", xlabel="baseline, m", ylabel="share of objects")
        draw_lines(overlap, rows["overlaps"], "overlap", "matched")
        overlap.set(title="The same", xlabel=f"overlap, in bins of {OVERLAPS[1:-1]}")
        draw_lines(copies, rows["copies"], "copies", "pixels")
        copies.set(title="Pixels with one id in both views", xlabel="copies of each view")
        copies.set_ylabel("share of common pixels")
        copies.set_xticks([row["copies"] for row in rows["copies"] if row["tracker"] == "noisy"])
        draw_times(time, rows["trackers"])
        figure.legend(
            *copies.get_legend_handles_labels(), loc="outside upper right", ncols=3, frameon=False
        )
        out = io.BytesIO()
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def draw_lines(axes: Axes, rows: list[dict], over: str, column: str) -> None:
    for tracker, color in COLORS.items():
        points = [(row[over], row[column]) for row in rows if row["tracker"] == tracker]
        if points:
            axes.plot(
                *zip(*points, strict=True), color=color, marker=MARKERS[tracker], label=tracker
            )
    axes.grid(color=FAINT)


def draw_times(axes: Axes, trackers: list[dict]) -> None:
    """Matched against the seconds of tracking, the reverse pass with hollow markers."""
    for row in trackers:
        if row["proposals"] == "regions":
            axes.plot(
                row["track"],
                row["matched"],
                color=COLORS[row["tracker"]],
                marker=MARKERS[row["tracker"]],
                fillstyle="full" if row["way"] == "forth" else "none",
            )
    axes.margins(0.2)
    axes.set_xlim(left=0)
    axes.grid(color=FAINT)
    axes.set(title="Error against time: up and left is better", xlabel="tracking a pair, CPU s")
    axes.set_ylabel("objects matched; hollow: and back")
