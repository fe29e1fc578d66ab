"""Typical scene depth of the views of a clip from sparse matches, enough to estimate overlap.

Without refinement or dense matching: a fraction of a second for a clip of hundreds of frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from slgaussian.cameras.matches import LOWE_RATIO, Features, match, sift
from slgaussian.cameras.relative import Relative
from slgaussian.predict.depth_hypotheses import MIN_MATCHES
from slgaussian.predict.pose_refinement import MAX_EPIPOLAR_DISTANCE
from slgaussian.predict.view_graph import MIN_PARALLAX
from slgaussian.scene import Camera

MIN_MATCHED_VIEWS = 4
"""Smallest number of matched views, if there are as many."""

MAX_FRAME_STEP = 20
"""Largest number of frames between matched views: two thirds of a second of a published clip."""


def typical_depths(greys: Sequence[np.ndarray], cameras: Sequence[Camera]) -> np.ndarray:
    """Estimate the median z-depth of each view of a clip.

    Views at regular intervals are matched with a later view, as far ahead as there are matches, and
    the matches are triangulated. Depths of views between are interpolated in the logarithm.

    Args:
        greys: sequence of N uint8 [h, w]. In temporal order.
        cameras: sequence of N Camera. Of the images at their size.

    Returns:
        float64 [N]: Scene units; NaN everywhere if no two views have enough matches with parallax.
    """
    n = len(greys)
    stride = min(max(n // MIN_MATCHED_VIEWS, 1), MAX_FRAME_STEP)
    features = cache(lambda view: sift(greys[view]))
    log_depths: dict[int, list[float]] = {}
    ahead = stride
    for a in range(0, n - 1, stride):
        ahead = min(2 * ahead, stride)
        depths = None
        while depths is None and ahead:
            b = min(a + ahead, n - 1)
            depths = _median_depths(features(a), features(b), cameras[a], cameras[b])
            ahead = ahead if depths else ahead // 2
        ahead = max(ahead, 1)
        if depths is not None:
            log_depths.setdefault(a, []).append(depths[0])
            log_depths.setdefault(b, []).append(depths[1])
    if not log_depths:
        return np.full(n, np.nan)
    matched = sorted(log_depths)
    means = [np.mean(np.log(log_depths[view])) for view in matched]
    return np.exp(np.interp(np.arange(n), matched, means))


def _median_depths(
    features_a: Features, features_b: Features, camera_a: Camera, camera_b: Camera
) -> tuple[float, float] | None:
    """Return the median depth of the matches in each of two views, None without parallax."""
    if not np.linalg.norm(camera_a.center - camera_b.center) > 0:
        return None
    relative = Relative.between(camera_a, camera_b)
    i, j, _ = match(features_a, features_b, LOWE_RATIO)
    if not len(i):
        return None
    a, b = features_a.points[i], features_b.points[j]
    gate = MAX_EPIPOLAR_DISTANCE * float(np.hypot(camera_a.height, camera_a.width))
    fits = np.abs(relative.epipolar_distance(a, b)) < gate
    a, b = a[fits], b[fits]
    near_a, near_b = relative.triangulate(a, b), relative.reverse().triangulate(b, a)
    front = (near_a > 0) & (near_b > 0)
    if front.sum() < MIN_MATCHES:
        return None
    if np.percentile(near_a[front] * relative.parallax(a[front]), 90) < MIN_PARALLAX:
        return None
    return float(1 / np.median(near_a[front])), float(1 / np.median(near_b[front]))
