"""What the views agree on: where their cameras stand, and the colours of what both of them show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numba import njit, prange
from scipy.spatial.transform import Rotation

from slgaussian.predict.fill import AGREES, cross_check
from slgaussian.predict.links import Link
from slgaussian.scene import Camera

FEATHER = 16.0
"""Distance from the image border, pixels, over which a view gains its full say in a blend: where
its image ends there is no seam then."""


def meet(cameras: Sequence[Camera], links: Sequence[Sequence[Link]]) -> list[Camera]:
    """The cameras, moved by the least that gives them the refined relative poses of the links.

    Depths fit the refined poses that they were matched with; placed with the given ones, the two
    copies of a surface lie beside each other and blur. Rotations are corrected first, then centres,
    each in least squares over the links and with the least change: two views go half way each.
    Where they differ by a few degrees, three and more rotations meet to first order only.
    """
    rows, turns, pairs = [], [], []
    for i, link in ((i, link) for i, sources in enumerate(links) for link in sources):
        R_i, R_j = cameras[i].c2w[:3, :3], cameras[link.source].c2w[:3, :3]
        row = np.zeros(len(cameras))
        row[i], row[link.source] = 1, -1
        rows.append(row)
        turns.append(Rotation.from_matrix(R_j @ link.relative.R @ R_i.T).as_rotvec())
        pairs.append((i, link))
    least = np.linalg.pinv(np.array(rows))
    poses = [camera.c2w.copy() for camera in cameras]
    for pose, turn in zip(poses, least @ np.array(turns), strict=True):
        pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ pose[:3, :3]
    gaps = [
        poses[link.source][:3, :3] @ link.relative.t - (poses[i] - poses[link.source])[:3, 3]
        for i, link in pairs
    ]
    for pose, move in zip(poses, least @ np.array(gaps), strict=True):
        pose[:3, 3] += move
    return [replace(camera, c2w=pose) for camera, pose in zip(cameras, poses, strict=True)]


def blend(
    images: Sequence[np.ndarray],
    inverse_depths: Sequence[np.ndarray],
    steps: Sequence[float],
    links: Sequence[Sequence[Link]],
) -> list[np.ndarray]:
    """Colours of every view, mixed with those of the linked views that show the same surface.

    So a surface has one colour, whichever view's copy of it is in front. A view counts fully, less
    within :data:`FEATHER` of its border, and not at all where its depth does not agree.

    Parameters
    ----------
    images : V of float32 [H, W, 3]
    inverse_depths : V of float32 [H, W]
    steps : V of float
        Distance between candidates, which agreement is measured by.
    links : V sequences of Link

    Returns
    -------
    V of float32 [H, W, 3]
    """
    mixed = []
    for i, sources in enumerate(links):
        H, W = inverse_depths[i].shape
        u, v = np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)
        weight = _say(u, v, W, H)
        total = images[i] * weight[..., None]
        for link in sources:
            other = inverse_depths[link.source]
            agrees = cross_check(inverse_depths[i], other, link.relative, steps[i]) == AGREES
            relative = link.relative
            _add(
                total, weight, agrees, inverse_depths[i], images[link.source],
                relative.infinity, relative.epipole, FEATHER,
            )  # fmt: skip
        mixed.append(total / weight[..., None])
    return mixed


def _say(u: np.ndarray, v: np.ndarray, width: int, height: int) -> np.ndarray:
    """Weight float32 of a view at its pixels (u, v)."""
    inwards = np.minimum(np.minimum(u, width - u), np.minimum(v, height - v))
    return np.minimum(inwards / FEATHER, 1).astype(np.float32)


@njit(cache=True, parallel=True)
def _add(total, weight, agrees, inverse_depth, image, A, e, feather):
    """Add what the other view shows, bilinear and by its weight, where it agrees."""
    H, W = inverse_depth.shape
    rows, columns, _ = image.shape
    for y in prange(H):
        for x in range(W):
            if not agrees[y, x]:
                continue
            a, b, w = x + 0.5, y + 0.5, float(inverse_depth[y, x])
            z = A[2, 0] * a + A[2, 1] * b + A[2, 2] + w * e[2]
            u = (A[0, 0] * a + A[0, 1] * b + A[0, 2] + w * e[0]) / z
            v = (A[1, 0] * a + A[1, 1] * b + A[1, 2] + w * e[1]) / z
            say = min(min(u, columns - u), min(v, rows - v)) / feather
            say = np.float32(min(say, 1.0))
            left, top = math.floor(u - 0.5), math.floor(v - 0.5)
            p, q = np.float32(u - 0.5 - left), np.float32(v - 0.5 - top)
            i0, i1 = max(left, 0), min(left + 1, columns - 1)
            j0, j1 = max(top, 0), min(top + 1, rows - 1)
            weight[y, x] += say
            for c in range(3):
                upper = (1 - p) * image[j0, i0, c] + p * image[j0, i1, c]
                lower = (1 - p) * image[j1, i0, c] + p * image[j1, i1, c]
                total[y, x, c] += say * ((1 - q) * upper + q * lower)
