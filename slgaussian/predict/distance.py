"""How far away the things in a clip are, from a few sparse matches: enough to tell what overlaps.

No refinement and no dense matching: a fraction of a second for a clip of hundreds of frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from slgaussian.cameras.matches import RATIO, Features, match, sift
from slgaussian.cameras.relative import Relative
from slgaussian.predict.depth_hypotheses import MIN_MATCHES
from slgaussian.predict.pose import GATE
from slgaussian.predict.view_graph import MIN_PARALLAX
from slgaussian.scene import Camera

ANCHORS = 4
"""Fewest views that are matched, if there are as many."""

STRIDE = 20
"""Most frames between two views that are matched: two thirds of a second of a published clip."""


def typical_depths(greys: Sequence[np.ndarray], cameras: Sequence[Camera]) -> np.ndarray:
    """Median z-depth of what each view of a clip shows.

    Every few views one is matched with a later one (SIFT, gated by the epipolar line of the given
    poses), as far ahead as matches are found, and these are triangulated. Views between take what
    lies between, in the logarithm.

    Parameters
    ----------
    greys : sequence of N uint8 [h, w]
        In the order in which they were taken.
    cameras : sequence of N Camera
        Of the images as given.

    Returns
    -------
    float64 [N]
        Scene units; NaN everywhere if no two views show enough matches with parallax.
    """
    n = len(greys)
    stride = min(max(n // ANCHORS, 1), STRIDE)
    features = cache(lambda view: sift(greys[view]))
    found: dict[int, list[float]] = {}
    ahead = stride
    for a in range(0, n - 1, stride):
        ahead = min(2 * ahead, stride)
        depths = None
        while depths is None and ahead:
            b = min(a + ahead, n - 1)
            depths = _matched(features(a), features(b), cameras[a], cameras[b])
            ahead = ahead if depths else ahead // 2
        ahead = max(ahead, 1)
        if depths is not None:
            found.setdefault(a, []).append(depths[0])
            found.setdefault(b, []).append(depths[1])
    if not found:
        return np.full(n, np.nan)
    known = sorted(found)
    return np.exp(np.interp(np.arange(n), known, [np.mean(np.log(found[k])) for k in known]))


def _matched(
    features_a: Features, features_b: Features, camera_a: Camera, camera_b: Camera
) -> tuple[float, float] | None:
    """Median depth of the matches in each of two views, None if they say nothing."""
    if not np.linalg.norm(camera_a.center - camera_b.center) > 0:
        return None
    there = Relative.between(camera_a, camera_b)
    i, j, _ = match(features_a, features_b, RATIO)
    if not len(i):
        return None
    a, b = features_a.points[i], features_b.points[j]
    gate = GATE * float(np.hypot(camera_a.height, camera_a.width))
    fits = np.abs(there.epipolar_distance(a, b)) < gate
    a, b = a[fits], b[fits]
    near_a, near_b = there.triangulate(a, b), there.reversed().triangulate(b, a)
    front = (near_a > 0) & (near_b > 0)
    if front.sum() < MIN_MATCHES:
        return None
    if np.percentile(near_a[front] * there.parallax(a[front]), 90) < MIN_PARALLAX:
        return None
    return float(1 / np.median(near_a[front])), float(1 / np.median(near_b[front]))
