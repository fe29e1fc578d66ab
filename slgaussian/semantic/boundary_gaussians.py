"""Gaussians along the boundary of an object that have its depth but not its label.

Edges in label maps, depth and colour do not coincide to the pixel. When an object is removed, a
thin line of it therefore remains along its outline, in front of the background. These Gaussians are
detected by three conditions: they project next to the outline in a view, they are as deep as the
object, and the mean depth of the background around them is larger. Where an object stands on a
surface there is no depth step, and no Gaussian is detected.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from slgaussian.scene import Camera

BOUNDARY_RADIUS = 3
"""Largest distance of boundary Gaussians from the outline, in views of some hundred pixels."""

BACKGROUND_RADIUS = 10
"""Distance from the outline within which the background depth is averaged, pixels."""

DEPTH_TOLERANCE = 0.03
"""Largest relative difference in depth between a boundary Gaussian and the object."""

DEPTH_STEP = 1.1
"""Smallest ratio of background depth to object depth."""


def boundary_gaussians(
    means: np.ndarray,
    removed: np.ndarray,
    cameras: Sequence[Camera],
    depths: Sequence[np.ndarray],
    masks: Sequence[np.ndarray],
) -> np.ndarray:
    """Find the Gaussians along the boundary of an object, bool [N].

    Args:
        means: float [N, 3]. Centres in the world.
        removed: bool [N]. Gaussians of the object itself.
        cameras: V Camera
        depths: V of float32 [H, W]. z-depth of the views, the object included; 0 where empty.
        masks: V of bool [H, W]. Pixels of the object.
    """
    flagged = np.zeros(len(means), bool)
    rest = np.flatnonzero(~removed)
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
    """Return the smallest and largest depth of boundary Gaussians at each pixel.

    Both float32 [H, W]; away from the boundary the smallest exceeds the largest.
    """
    object_depth = np.where(mask, depth, 0).astype(np.float32)
    window = _square(BOUNDARY_RADIUS + 1)
    far = cv2.dilate(object_depth, window)
    near = cv2.erode(np.where(object_depth > 0, object_depth, np.inf).astype(np.float32), window)
    outside = _dilate(mask, BACKGROUND_RADIUS) & ~_dilate(mask, 2 * BOUNDARY_RADIUS) & (depth > 0)
    box = (2 * BACKGROUND_RADIUS + 11, 2 * BACKGROUND_RADIUS + 11)
    total = cv2.blur(np.where(outside, depth, 0).astype(np.float32), box)
    share = cv2.blur(outside.astype(np.float32), box)
    background = total / np.maximum(share, 1e-6)
    edge = _dilate(mask, BOUNDARY_RADIUS) & (background >= DEPTH_STEP * far) & np.isfinite(near)
    nearest, farthest = near * (1 - DEPTH_TOLERANCE), far * (1 + DEPTH_TOLERANCE)
    return np.where(edge, nearest, np.inf), np.where(edge, farthest, 0)


def _dilate(mask: np.ndarray, radius: int) -> np.ndarray:
    dilated: np.ndarray = cv2.dilate(mask.astype(np.uint8), _square(radius)) > 0
    return dilated


def _square(radius: int) -> np.ndarray:
    return np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
