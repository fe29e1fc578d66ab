"""Relative poses of pairs of photographs, by this program, OpenCV and PoseLib.

    python -m benches.cameras.relative_pose DATA [-o docs/measured] [--rows FILE]

:mod:`benches.cameras.posed_photographs` reads DATA. Each method gets the unchanged photographs and
detects its own features. The error of a pair is the larger of the angular errors of rotation and
direction of translation. Intervals are from the bootstrap over pairs. FILE gets a row per pair and
method, as JSON lines.
"""

from __future__ import annotations

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
from benches.cameras.posed_photographs import PosedPair, posed_pairs
from benches.common.harness import parser, publish, table
from benches.common.photograph_pairs import data_folder
from slgaussian.benchmark.statistics import interval, resamplings
from slgaussian.cameras.epipolar import FocalPrior
from slgaussian.cameras.estimated import DOUBTFUL, UNUSED
from slgaussian.cameras.find import find_cameras
from slgaussian.cameras.two_view import Described, Photograph, find_pair
from slgaussian.errors import InputError
from slgaussian.scene import View

DRAWS = 1000
"""Number of bootstrap resamples."""


class Answer(NamedTuple):
    """Relative pose ``X_b = R @ X_a + t``, and the two focal lengths in pixels if estimated.

    ``intervals`` are the 90 % intervals of the focal lengths, and ``doubted`` is whether the method
    doubts its answer; None if the method has no such output.
    """

    R: np.ndarray
    t: np.ndarray
    focals: tuple[float, float] | None = None
    intervals: tuple[tuple[float, float], tuple[float, float]] | None = None
    doubted: bool | None = None


ERRORS = ("rotation", "direction", "focal", "inside", "doubted")
"""Errors of the pose in degrees, relative error of the focal lengths, share of true focal lengths
in their interval, and 1 for a doubted answer."""

Method = Callable[[View, View], Answer | None]


def opencv_with_focals(a: View, b: View) -> Answer | None:
    at_a, at_b = plain_opencv.matches(a.image, b.image)
    pose = plain_opencv.relative_pose(at_a, at_b, a.camera.K, b.camera.K)
    return pose and Answer(*pose)


def opencv_without_focals(a: View, b: View) -> Answer | None:
    at_a, at_b = plain_opencv.matches(a.image, b.image)
    K_a, K_b = (plain_opencv.guess_intrinsics(v.camera.width, v.camera.height) for v in (a, b))
    pose = plain_opencv.relative_pose(at_a, at_b, K_a, K_b)
    return pose and Answer(*pose, (K_a[0, 0], K_b[0, 0]))


def poselib_with_focals(a: View, b: View) -> Answer | None:
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


def ours_with_focals(a: View, b: View) -> Answer | None:
    K = [view.camera.K for view in (a, b)]
    # Crop so that the principal point is in the centre, as our method assumes.
    images = [_crop_around(view.image, *k[:2, 2]) for view, k in zip((a, b), K, strict=True)]
    described = (
        Described.of(Photograph(name, image, image.shape[1], image.shape[0]))
        for name, image in zip("ab", images, strict=True)
    )
    focals = np.log([(k[0, 0] + k[1, 1]) / 2 for k in K])
    pose = find_pair(*described, FocalPrior(focals, np.zeros(2), shared=False))
    if pose.estimate.verdict == UNUSED or pose.views is None:
        return None
    return Answer(pose.views.R, pose.views.t, doubted=pose.estimate.verdict == DOUBTFUL)


def _crop_around(image: np.ndarray, x: float, y: float) -> np.ndarray:
    """Return the largest crop of an image centred at (x, y), up to half a pixel."""
    (height, width), (right, down) = image.shape[:2], np.round(2 * np.array([x, y])).astype(int)
    left, top = max(0, right - width), max(0, down - height)
    return np.ascontiguousarray(image[top : min(down, height), left : min(right, width)])


def ours(a: View, b: View) -> Answer | None:
    photographs = [
        Photograph(name, view.image, view.camera.width, view.camera.height)
        for name, view in (("a", a), ("b", b))
    ]
    try:
        estimate = find_cameras(photographs)
    except InputError:
        return None
    relative = estimate.cameras["b"].w2c @ estimate.cameras["a"].c2w
    first, second = estimate.focals["a"], estimate.focals["b"]
    return Answer(
        relative[:3, :3],
        relative[:3, 3],
        (first.pixels, second.pixels),
        ((first.low, first.high), (second.low, second.high)),
        estimate.pairs[0].verdict == DOUBTFUL,
    )


def methods() -> dict[str, Method]:
    available: dict[str, Method] = {
        "OpenCV, K known": opencv_with_focals,
        "OpenCV, f = 1.2 max(w, h)": opencv_without_focals,
    }
    if importlib.util.find_spec("poselib"):
        available["poselib, K known"] = poselib_with_focals
    return {**available, "ours, K known": ours_with_focals, "ours, focal unknown": ours}


def measure(pairs: Iterable[PosedPair]) -> list[dict[str, Any]]:
    """Return a row per pair and method; errors are NaN if the method has no answer."""
    rows = []
    for pair in pairs:
        true_pose = pair.b.camera.w2c @ pair.a.camera.c2w
        for name, method in methods().items():
            start = time.process_time()
            answer = method(pair.a, pair.b)
            row = {
                "group": pair.group,
                "pair": pair.name,
                "method": name,
                "seconds": time.process_time() - start,
            }
            rows.append({**row, **_errors(answer, pair, true_pose)})
    return rows


def _errors(answer: Answer | None, pair: PosedPair, true_pose: np.ndarray) -> dict[str, float]:
    """Compute the errors of an answer; NaN without an answer or a reference."""
    if answer is None:
        return dict.fromkeys(ERRORS, float("nan"))
    true = [(view.camera.K[0, 0] + view.camera.K[1, 1]) / 2 for view in (pair.a, pair.b)]
    focal = inside = float("nan")
    if answer.focals is not None and pair.focal_known:
        focal = float(np.abs(np.divide(answer.focals, true) - 1).mean())
    if answer.intervals is not None and pair.focal_known:
        within = zip(answer.intervals, true, strict=True)
        inside = float(np.mean([low < f < high for (low, high), f in within]))
    errors = (
        rotation_error(answer.R, true_pose[:3, :3]),
        direction_error(answer.t, true_pose[:3, 3]),
        focal,
        inside,
        float("nan") if answer.doubted is None else float(answer.doubted),
    )
    return dict(zip(ERRORS, errors, strict=True))


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row per group and method."""
    groups: dict[str, Callable[[str], bool]] = {
        "all but places": lambda group: group != "places",
        "places": lambda group: group == "places",
        "all": lambda group: True,
    }
    out = []
    for title, in_group in groups.items():
        for method in dict.fromkeys(row["method"] for row in rows):
            selected = [row for row in rows if in_group(row["group"]) and row["method"] == method]
            if not selected:
                continue
            errors = np.array([max(row["rotation"], row["direction"]) for row in selected])
            answered = np.isfinite(errors)
            bounded_errors = np.where(answered, errors, np.inf)
            areas = np.array(
                [area_under_curve(bounded_errors[i]) for i in resamplings(len(selected))[:DRAWS]]
            )
            ends = [interval(area) for area in areas.T]
            wrong = answered & (errors > WRONG)
            line = {
                "group": title,
                "method": method,
                "pairs": len(selected),
                "auc": "/".join(f"{area:.1f}" for area in area_under_curve(bounded_errors)),
                "ends": ", ".join(f"{low:.0f} to {high:.0f}" for low, high in ends),
                "refused": int((~answered).sum()),
                "wrong": int(wrong.sum()),
                "seconds": float(np.median([row["seconds"] for row in selected])),
            }
            focal, inside, doubted = (
                np.array([row[key] for row in selected]) for key in ("focal", "inside", "doubted")
            )
            if np.isfinite(focal).any():
                line["focal"] = float(np.nanmedian(focal))
            if np.isfinite(inside).any():
                line["inside"] = float(np.nanmean(inside))
            if np.isfinite(doubted).any():
                line["doubted"] = float(np.nanmean(doubted))
                line["sure"] = int((wrong & (doubted == 0)).sum())
            out.append(line)
    return out


COLUMNS = {
    "group": ("pairs of", str),
    "method": ("method", str),
    "pairs": ("pairs", "d"),
    "auc": ("AUC 5/10/20°", str),
    "ends": ("95 % interval", str),
    "refused": ("refused", "d"),
    "wrong": ("wrong", "d"),
    "doubted": ("doubted", ".0%"),
    "sure": ("wrong, not doubted", "d"),
    "focal": ("focal error, median", ".0%"),
    "inside": ("in its 90 % interval", ".0%"),
    "seconds": ("CPU s, median", ".2f"),
}


def main() -> None:
    arguments = parser(__doc__, "poses.md")
    arguments.add_argument("data", type=data_folder("office/pairs.json"), help="folder of places")
    arguments.add_argument("--rows", type=Path, help="file for the rows")
    args = arguments.parse_args()
    cv2.setNumThreads(1)
    rows = measure(posed_pairs(args.data))
    if args.rows:
        args.rows.write_text("".join(json.dumps(row) + "\n" for row in rows))
    command = "python -m benches.cameras.relative_pose DATA"
    publish(args.out, "poses.md", command, table(summary(rows), COLUMNS))


if __name__ == "__main__":
    main()
