"""Relative poses of pairs of photographs, by ours and by what else there is.

    python -m benches.cameras.relative_pose DATA [--rows FILE]

DATA is what :mod:`benches.cameras.posed_pairs` reads. Every method finds its own features and gets
the photographs as they are; the error of a pair is the larger of the angles by which rotation and
direction of translation are off. poselib is asked where it is installed. Intervals are those of the
bootstrap over pairs, which is somewhat narrow for the walk, whose pairs share photographs. FILE
keeps a row a pair and method, as JSON lines.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from benches.cameras import plain_opencv
from benches.cameras.pose_metrics import (
    WRONG,
    area_under_curve,
    direction_error,
    rotation_error,
)
from benches.cameras.posed_pairs import PosedPair, posed_pairs
from benches.common.machine import measured
from benches.common.markdown_tables import percent, table
from benches.common.photograph_pairs import data_folder
from slgaussian.benchmark.statistics import LEVEL, interval, resamplings
from slgaussian.cameras.epipolar import FocalPrior
from slgaussian.cameras.estimated import DOUBTFUL, UNUSED
from slgaussian.cameras.find import find_cameras
from slgaussian.cameras.two_view import Described, Photograph, find_pair
from slgaussian.errors import InputError
from slgaussian.scene import View

FEASIBLE = 10.0
"""Degrees within which OpenCV's pose with the true intrinsics lies where a pair can be solved."""

DRAWS = 1000
"""Resamplings that an interval is taken from."""

KNOWN, GUESSED = "OpenCV, K known", "OpenCV, f = 1.2 max(w, h)"


class Answer(NamedTuple):
    """``X_b = R @ X_a + t``, and the two focal lengths in pixels if they were found.

    Where a method says so, with the ends of the intervals that hold them nine times in ten, and
    whether all this is doubted.
    """

    R: np.ndarray
    t: np.ndarray
    focals: tuple[float, float] | None = None
    intervals: tuple[tuple[float, float], tuple[float, float]] | None = None
    doubted: bool | None = None


JUDGED = ("rotation", "direction", "focal", "inside", "doubted")
"""Errors in degrees and in parts; the share of the true focal lengths that lie in their interval;
and 1 for a doubted answer."""

Method = Callable[[View, View], Answer | None]


def opencv_known(a: View, b: View) -> Answer | None:
    at_a, at_b = plain_opencv.matches(a.image, b.image)
    found = plain_opencv.relative_pose(at_a, at_b, a.camera.K, b.camera.K)
    return found and Answer(*found)


def opencv_guessed(a: View, b: View) -> Answer | None:
    at_a, at_b = plain_opencv.matches(a.image, b.image)
    K_a, K_b = (plain_opencv.guessed(v.camera.width, v.camera.height) for v in (a, b))
    found = plain_opencv.relative_pose(at_a, at_b, K_a, K_b)
    return found and Answer(*found, (K_a[0, 0], K_b[0, 0]))


def poselib_known(a: View, b: View) -> Answer | None:
    import poselib

    at_a, at_b = plain_opencv.matches(a.image, b.image)
    cameras = [
        {
            "model": "PINHOLE",
            "width": view.camera.width,
            "height": view.camera.height,
            "params": view.camera.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(),
        }
        for view in (a, b)
    ]
    if len(at_a) < 8:
        return None
    pose, _ = poselib.estimate_relative_pose(at_a, at_b, *cameras, {"max_epipolar_error": 1.0}, {})
    return Answer(pose.R, pose.t)


def ours_known(a: View, b: View) -> Answer | None:
    K = [view.camera.K for view in (a, b)]
    # Cut so that the principal point is in the middle, where ours takes it to be.
    images = [_centred(view.image, *k[:2, 2]) for view, k in zip((a, b), K, strict=True)]
    described = (
        Described.of(Photograph(name, image, image.shape[1], image.shape[0]))
        for name, image in zip("ab", images, strict=True)
    )
    focals = np.log([(k[0, 0] + k[1, 1]) / 2 for k in K])
    pose = find_pair(*described, FocalPrior(focals, np.zeros(2), shared=False))
    if pose.found.verdict == UNUSED or pose.views is None:
        return None
    return Answer(pose.views.R, pose.views.t, doubted=pose.found.verdict == DOUBTFUL)


def _centred(image: np.ndarray, x: float, y: float) -> np.ndarray:
    """The largest window of an image with its middle, but for half a pixel, at (x, y)."""
    (height, width), (right, down) = image.shape[:2], np.round(2 * np.array([x, y])).astype(int)
    left, top = max(0, right - width), max(0, down - height)
    return np.ascontiguousarray(image[top : min(down, height), left : min(right, width)])


def ours(a: View, b: View) -> Answer | None:
    photographs = [
        Photograph(name, view.image, view.camera.width, view.camera.height)
        for name, view in (("a", a), ("b", b))
    ]
    try:
        found = find_cameras(photographs)
    except InputError:
        return None
    there = found.cameras["b"].w2c @ found.cameras["a"].c2w
    one, other = found.focals["a"], found.focals["b"]
    return Answer(
        there[:3, :3],
        there[:3, 3],
        (one.pixels, other.pixels),
        ((one.low, one.high), (other.low, other.high)),
        found.pairs[0].verdict == DOUBTFUL,
    )


def methods() -> dict[str, Method]:
    asked: dict[str, Method] = {KNOWN: opencv_known, GUESSED: opencv_guessed}
    if importlib.util.find_spec("poselib"):
        asked["poselib, K known"] = poselib_known
    return {**asked, "ours, K known": ours_known, "ours, focal unknown": ours}


def measure(pairs: Iterable[PosedPair]) -> list[dict[str, Any]]:
    """A row a pair and method; errors are NaN where a method gave no answer."""
    rows = []
    for pair in pairs:
        there = pair.b.camera.w2c @ pair.a.camera.c2w
        for name, method in methods().items():
            start = time.process_time()
            answer = method(pair.a, pair.b)
            row = {
                "group": pair.group,
                "pair": pair.name,
                "method": name,
                "seconds": time.process_time() - start,
            }
            rows.append({**row, **_errors(answer, pair, there)})
    return rows


def _errors(answer: Answer | None, pair: PosedPair, there: np.ndarray) -> dict[str, float]:
    """Of an answer; NaN for what is not known of it, or cannot be judged."""
    if answer is None:
        return dict.fromkeys(JUDGED, float("nan"))
    true = [(view.camera.K[0, 0] + view.camera.K[1, 1]) / 2 for view in (pair.a, pair.b)]
    focal = inside = float("nan")
    if answer.focals is not None and pair.focal_known:
        focal = float(np.abs(np.divide(answer.focals, true) - 1).mean())
    if answer.intervals is not None and pair.focal_known:
        within = zip(answer.intervals, true, strict=True)
        inside = float(np.mean([low < f < high for (low, high), f in within]))
    errors = (
        rotation_error(answer.R, there[:3, :3]),
        direction_error(answer.t, there[:3, 3]),
        focal,
        inside,
        float("nan") if answer.doubted is None else float(answer.doubted),
    )
    return dict(zip(JUDGED, errors, strict=True))


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row a group and method, with the shares that a table shows."""
    groups = list(dict.fromkeys(row["group"] for row in rows))
    named = {group: [group] for group in groups}
    named |= {"all but places": [group for group in groups if group != "places"], "all": groups}
    feasible = {
        row["pair"]
        for row in rows
        if row["method"] == KNOWN and max(row["rotation"], row["direction"]) < FEASIBLE
    }
    out = []
    for title, chosen in named.items():
        for method in dict.fromkeys(row["method"] for row in rows):
            own = [row for row in rows if row["group"] in chosen and row["method"] == method]
            errors = np.array([max(row["rotation"], row["direction"]) for row in own])
            answered = np.isfinite(errors)
            off = np.where(answered, errors, np.inf)
            solvable = np.array([row["pair"] in feasible for row in own])
            focal, inside, doubted = (
                np.array([row[key] for row in own]) for key in ("focal", "inside", "doubted")
            )
            drawn = resamplings(len(own))[:DRAWS]
            areas = np.array([area_under_curve(off[some]) for some in drawn])
            ends = [interval(area) for area in areas.T]
            wrong = answered & (errors > WRONG)
            line = {
                "group": title,
                "method": method,
                "pairs": len(own),
                "auc": "/".join(f"{area:.1f}" for area in area_under_curve(off)),
                "auc_ends": ", ".join(f"{low:.0f} to {high:.0f}" for low, high in ends),
                "refused": int((~answered).sum()),
                "wrong": int(wrong.sum()),
                "wrong_share": float(wrong.sum() / max(answered.sum(), 1)),
                "refused_feasible": float((~answered)[solvable].mean()) if solvable.any() else 0.0,
                "seconds": float(np.median([row["seconds"] for row in own])),
            }
            if np.isfinite(focal).any():
                line["focal"] = float(np.nanmedian(focal))
                # Of a resampling that holds no focal length there is no median.
                known = [some for some in drawn if np.isfinite(focal[some]).any()]
                medians = np.array([np.nanmedian(focal[some]) for some in known])
                line["focal_ends"] = interval(medians)
            if np.isfinite(inside).any():
                line["inside"] = float(np.nanmean(inside))
            if np.isfinite(doubted).any():
                line["doubted"] = float(np.nanmean(doubted))
                line["unsaid"] = int((wrong & (doubted == 0)).sum())
            out.append(line)
    return out


def _percents(ends: tuple[float, float]) -> str:
    return f"{100 * ends[0]:.0f} to {percent(ends[1])}"


COLUMNS = {
    "group": ("pairs of", str),
    "method": ("method", str),
    "pairs": ("pairs", "d"),
    "auc": ("AUC 5/10/20°", str),
    "auc_ends": (f"{percent(LEVEL)} of draws", str),
    "refused": ("refused", "d"),
    "wrong": ("wrong", "d"),
    "wrong_share": ("of the answered", percent),
    "refused_feasible": ("refused of the feasible", percent),
    "seconds": ("CPU s, median", ".2f"),
}

OF_ANSWERS = {
    "group": ("pairs of", str),
    "method": ("method", str),
    "focal": ("focal error, median", percent),
    "focal_ends": (f"{percent(LEVEL)} of draws", _percents),
    "inside": ("in its 90 % interval", percent),
    "doubted": ("doubted", percent),
    "wrong": ("wrong", "d"),
    "unsaid": ("wrong and not doubted", "d"),
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=data_folder("office/pairs.json"), help="folder of places")
    parser.add_argument("--rows", type=Path, help="where rows are kept")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    rows = measure(posed_pairs(given.data))
    if given.rows:
        given.rows.write_text("".join(json.dumps(row) + "\n" for row in rows))
    lines = summary(rows)
    print(f"{measured()}\n")
    print(table(lines, COLUMNS))
    print()
    print(table([line for line in lines if "focal" in line or "doubted" in line], OF_ANSWERS))
    print(
        f"\nWrong: answered and more than {WRONG:g} degrees off. Feasible: pairs on which OpenCV "
        f"with K known is within {FEASIBLE:g} degrees. Focal lengths are not judged where the "
        "photographs themselves do not tell them."
    )


if __name__ == "__main__":
    main()
