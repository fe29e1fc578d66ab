"""Gaussians along the boundary of an object that have its depth, and another label.

Label maps, depth and colour do not change at the very same pixel. So when an object is removed, a
thin line of it stays where its outline was, in front of what lies behind. Such Gaussians are told
by their place: beside the outline in a view, as deep as the object, with a background around them
that is farther away on the whole. Where an object stands on something there is no such step, and
nothing is taken.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from slgaussian.scene import Camera

BESIDE = 3
"""Pixels from the outline within which they lie, in views of some hundred pixels."""

AROUND = 10
"""Pixels from the outline up to which the background is looked at."""

ALIKE = 0.03
"""They are nearer or farther than the object there by at most this share."""

STEP = 1.1
"""The background is so many times as far as the object, at least."""


def boundary_gaussians(
    means: np.ndarray,
    gone: np.ndarray,
    cameras: Sequence[Camera],
    depths: Sequence[np.ndarray],
    masks: Sequence[np.ndarray],
) -> np.ndarray:
    """Find the Gaussians along the boundary of an object, bool [N].

    Parameters
    ----------
    means : float [N, 3]
        Centres in the world.
    gone : bool [N]
        Those of the object itself.
    cameras : V Camera
    depths : V of float32 [H, W]
        z-depth of what the views show, the object among it; 0 where nothing is.
    masks : V of bool [H, W]
        Where they show the object.
    """
    flagged = np.zeros(len(means), bool)
    rest = np.flatnonzero(~gone)
    for camera, depth, mask in zip(cameras, depths, masks, strict=True):
        if not mask.any():
            continue
        near, far = _depth_range(depth, mask)
        pixels, z = camera.project(means[rest])
        u, v = np.floor(pixels).astype(np.int64).T
        inside = (z > 0) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        u, v, z, rows = u[inside], v[inside], z[inside], rest[inside]
        flagged[rows[(z >= near[v, u]) & (z <= far[v, u])]] = True
    return flagged


def _depth_range(depth: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the depths of boundary Gaussians at each pixel, from and to.

    Both float32 [H, W]; from > to elsewhere.
    """
    object_depth = np.where(mask, depth, 0).astype(np.float32)
    window = _square(BESIDE + 1)
    far = cv2.dilate(object_depth, window)
    near = cv2.erode(np.where(object_depth > 0, object_depth, np.inf).astype(np.float32), window)
    outside = _grown(mask, AROUND) & ~_grown(mask, 2 * BESIDE) & (depth > 0)
    around = (2 * AROUND + 11, 2 * AROUND + 11)
    total = cv2.blur(np.where(outside, depth, 0).astype(np.float32), around)
    share = cv2.blur(outside.astype(np.float32), around)
    behind = total / np.maximum(share, 1e-6)
    edge = _grown(mask, BESIDE) & (behind >= STEP * far) & np.isfinite(near)
    return np.where(edge, near * (1 - ALIKE), np.inf), np.where(edge, far * (1 + ALIKE), 0)


def _grown(mask: np.ndarray, radius: int) -> np.ndarray:
    grown: np.ndarray = cv2.dilate(mask.astype(np.uint8), _square(radius)) > 0
    return grown


def _square(radius: int) -> np.ndarray:
    return np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
