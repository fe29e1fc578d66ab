"""Where cameras are no longer found: procedural pairs made hard by one thing at a time, and by all.

    python -m benches.cameras.procedural_pairs [-o FOLDER] [--rows FILE]

Plain OpenCV is told the true focal length, but not the distortion; ours is told nothing. A row of
the table is one level of one condition over several rooms; at "all", conditions are drawn by seeds.
FOLDER gets a chart, ``procedural_pairs.svg``; FILE keeps a row a pair and method, as JSON lines.
"""

from __future__ import annotations

import argparse
import io
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import matplotlib.ticker
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benches.cameras import plain_opencv
from benches.cameras.photographed_rooms import EASY, FACTORS, Conditions, Shot, mixed, shoot
from benches.cameras.pose_metrics import WRONG, direction_error, rotation_error
from benches.common.chart_style import BLUE, FAINT, ORANGE, STYLE
from benches.common.machine import measured
from benches.common.markdown_tables import percent, table
from slgaussian.cameras.find import find_cameras
from slgaussian.errors import InputError
from slgaussian.io import write_atomic

ROOMS = range(4)
MIXED = range(100, 164)

OPENCV, OURS = "OpenCV, K known", "ours, nothing known"


def pairs() -> Iterator[tuple[str, float, int, Conditions]]:
    """Condition, level, seed and all conditions of every pair, those that share a room together."""
    for seed in ROOMS:
        yield "none", 0.0, seed, EASY
        for factor, (_, levels) in FACTORS.items():
            for level, conditions in levels.items():
                yield factor, level, seed, conditions
    for seed in MIXED:
        yield "all", 0.0, seed, mixed(seed)


def opencv(shot: Shot) -> tuple[np.ndarray, np.ndarray, None] | None:
    a, b = shot.photographs
    found = plain_opencv.relative_pose(
        *plain_opencv.matches(a.image, b.image), *(camera.K for camera in shot.cameras)
    )
    return found and (*found, None)


def ours(shot: Shot) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    try:
        found = find_cameras(shot.photographs)
    except InputError:
        return None
    a, b = (found.cameras[photograph.name] for photograph in shot.photographs)
    there = b.w2c @ a.c2w
    focals = np.array([found.focals[one.name].pixels for one in shot.photographs])
    return there[:3, :3], there[:3, 3], focals


def measure() -> list[dict[str, Any]]:
    """A row a pair and method; errors are NaN where there was no answer."""
    rows = []
    for factor, level, seed, conditions in pairs():
        shot = shoot(seed, conditions)
        a, b = shot.cameras
        there = b.w2c @ a.c2w
        true = np.array([a.K[0, 0], b.K[0, 0]])
        for name, method in ((OPENCV, opencv), (OURS, ours)):
            row = {"factor": factor, "level": level, "seed": seed, "method": name}
            errors = dict.fromkeys(("rotation", "direction", "focal"), float("nan"))
            answer = method(shot)
            if answer is not None:
                R, t, focals = answer
                errors["rotation"] = rotation_error(R, there[:3, :3])
                errors["direction"] = direction_error(t, there[:3, 3])
                if focals is not None:
                    errors["focal"] = float(np.abs(focals / true - 1).mean())
            rows.append({**row, **errors})
    return rows


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row a condition and level: medians of the answered by either method."""
    out = []
    for factor, level in dict.fromkeys((row["factor"], row["level"]) for row in rows):
        line = {"factor": factor, "level": "" if factor in ("none", "all") else f"{level:g}"}
        for method, short in ((OPENCV, "opencv"), (OURS, "ours")):
            own = [
                row
                for row in rows
                if (row["factor"], row["level"], row["method"]) == (factor, level, method)
            ]
            pose = np.array([[row["rotation"], row["direction"]] for row in own])
            pose = pose[np.isfinite(pose[:, 0])]
            line["pairs"] = len(own)
            line[f"{short} refused"] = len(own) - len(pose)
            line[f"{short} wrong"] = int((pose.max(1, initial=0) > WRONG).sum())
            if len(pose):
                line[f"{short} rotation"], line[f"{short} direction"] = np.median(pose, 0)
            focals = [row["focal"] for row in own if row["focal"] >= 0]
            if focals:
                line[f"{short} focal"] = float(np.median(focals))
        out.append(line)
    return out


COLUMNS = {
    "factor": ("condition", str),
    "level": ("level", str),
    "pairs": ("pairs", "d"),
    "opencv rotation": ("OpenCV: rotation, °", ".2f"),
    "opencv direction": ("direction, °", ".2f"),
    "opencv wrong": ("wrong", "d"),
    "ours rotation": ("ours: rotation, °", ".2f"),
    "ours direction": ("direction, °", ".2f"),
    "ours focal": ("focal length", percent),
    "ours refused": ("refused", "d"),
    "ours wrong": ("wrong", "d"),
}


def chart(rows: Sequence[dict[str, Any]]) -> bytes:
    """SVG: a panel a condition, the error of each pair over its level."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(13, 5.4), layout="constrained")
        panels = figure.subplots(2, (len(FACTORS) + 1) // 2, sharey=True).ravel()
        for axes, factor in zip(panels, FACTORS, strict=False):
            _panel(axes, factor, [row for row in rows if row["factor"] == factor])
        for axes in panels[:: len(panels) // 2]:
            axes.set_ylabel("pose error, degrees")
        handles, names = panels[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=2, frameon=False)
        out = io.BytesIO()
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


REFUSED_AT = 300.0
"""Where the chart marks what was refused; no error is so large."""


def _panel(axes: Axes, factor: str, rows: Sequence[dict[str, Any]]) -> None:
    words, levels = FACTORS[factor]
    axes.set(title=factor, xlabel=words, yscale="log", ylim=(0.02, 500))
    axes.set_xticks(range(len(levels)), [f"{level:g}" for level in levels])
    axes.set_yticks([0.1, 1, 10, 100, REFUSED_AT], ["0.1", "1", "10", "100", "refused"])
    axes.yaxis.set_minor_locator(matplotlib.ticker.NullLocator())
    axes.axhspan(WRONG, 200, color=FAINT, lw=0)
    for method, color, marker, aside in ((OPENCV, ORANGE, "s", 0.12), (OURS, BLUE, "o", -0.12)):
        own = [row for row in rows if row["method"] == method]
        x = [list(levels).index(row["level"]) + aside for row in own]
        worst = np.array([max(row["rotation"], row["direction"]) for row in own])
        y = np.where(np.isfinite(worst), np.clip(worst, 0.03, 200), REFUSED_AT)
        axes.scatter(x, y, s=22, color=color, marker=marker, alpha=0.7, lw=0, label=method)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--out", type=Path, help="folder for the chart")
    parser.add_argument("--rows", type=Path, help="where rows are kept")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    rows = measure()
    if given.rows:
        given.rows.write_text("".join(json.dumps(row) + "\n" for row in rows))
    print(f"{measured()}\n")
    print(table(summary(rows), COLUMNS))
    print(
        f"\n{len(rows) // 2} pairs; median errors of the answered. Wrong: more than {WRONG:g} "
        "degrees off. OpenCV is told K."
    )
    if given.out:
        given.out.mkdir(parents=True, exist_ok=True)
        write_atomic(given.out / "procedural_pairs.svg", chart(rows))


if __name__ == "__main__":
    main()
