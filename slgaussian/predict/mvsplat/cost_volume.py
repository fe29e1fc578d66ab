"""Cost volume: feature correlation of every pixel with other views at every candidate depth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import permutations

import numpy as np
import torch
import torch.nn.functional as F

from slgaussian.kernels.jit import kernel
from slgaussian.kernels.work_sharing import share, take
from slgaussian.scene import Camera

MIN_DEPTH = np.float32(1e-3)
"""Lower bound of depth in the target view, against division by zero."""

CHUNK_PIXELS = 1024
"""Pixels warped at a time: their samples at all depths take 64 MB."""

FAST_MATH = {"reassoc", "contract", "nsz"}
"""Fast-math flags for sums, without those that assume away NaN and infinity."""


def spread(near: float, far: float, count: int) -> torch.Tensor:
    """Return evenly spaced disparities from far to near, float32 [count]."""
    return 1 / far + torch.linspace(0, 1, count) * (1 / near - 1 / far)


def correlate(
    features: torch.Tensor, cameras: Sequence[Camera], disparities: torch.Tensor
) -> torch.Tensor:
    """Correlate every view with all others by a plane sweep, averaged over the others.

    A pixel of the reference is unprojected to each depth and projected into the other view, whose
    features are sampled bilinearly with zero padding. Pixel centres have integer coordinates, as
    in the training of the published networks.

    Args:
        features: float [V, C, h, w]
        cameras: V Camera. Of any size; intrinsics are scaled to (h, w).
        disparities: float32 [D]. Inverse depths along z.

    Returns:
        float32 [V, h, w, D]: Inner products over sqrt(C).
    """
    views, channels, h, w = features.shape
    maps = features.permute(0, 2, 3, 1).float().contiguous()
    volume = maps.new_zeros(views, h, w, len(disparities))
    for i, j in permutations(range(views), 2):
        lines, arrays = _paths(cameras[i], cameras[j], (h, w)), (maps[i], maps[j], disparities)
        if features.is_cpu:
            share(_add_products, h, *lines, *(a.numpy() for a in arrays), volume[i].numpy())
        else:
            volume[i] += warped_products(*lines, *arrays)
    return volume.mul_(1 / (channels**0.5 * (views - 1)))


def _paths(
    reference: Camera, target: Camera, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return start float32 [3, h * w] and offset [3] of the epipolar paths in ``target``.

    At disparity ``q`` the homogeneous position of a pixel of ``reference`` is ``start + q offset``.
    """
    h, w = size
    K_reference, K_target = reference.resize(w, h).K, target.resize(w, h).K
    motion = target.w2c @ reference.c2w
    v, u = np.mgrid[:h, :w].reshape(2, -1).astype(np.float64)
    pixels = np.stack([u, v, np.ones_like(u)])
    start = K_target @ motion[:3, :3] @ np.linalg.inv(K_reference) @ pixels
    return start.astype(np.float32), (K_target @ motion[:3, 3]).astype(np.float32)


def warped_products(
    start: np.ndarray,
    offset: np.ndarray,
    reference: torch.Tensor,
    target: torch.Tensor,
    disparities: torch.Tensor,
) -> torch.Tensor:
    """Compute what :func:`_add_products` adds, float32 [h, w, D], on any device by warping."""
    h, w, channels = reference.shape
    lines = torch.from_numpy(start).to(disparities.device)[..., None]
    x, y, z = (a + disparities * b for a, b in zip(lines, offset.tolist(), strict=True))
    z = torch.maximum(z, float(MIN_DEPTH) * disparities)
    # ``grid_sample`` has the outermost pixel centres at -1 and 1. It gives 0 beyond one pixel
    # outside, and NaN for infinite positions, which are therefore clamped.
    grid = torch.stack([x / z / (w - 1), y / z / (h - 1)], -1).mul_(2).sub_(1).clamp_(-3, 3)
    parts = []
    for places, features in zip(
        grid.split(CHUNK_PIXELS), reference.view(h * w, channels).split(CHUNK_PIXELS), strict=True
    ):
        warped = F.grid_sample(target.permute(2, 0, 1)[None], places[None], align_corners=True)[0]
        parts.append(torch.einsum("pc,cpd->pd", features, warped))
    return torch.cat(parts).view(h, w, -1)


@kernel(fastmath=FAST_MATH)
def _add_products(counter, start, offset, reference, target, disparities, out):
    """Add to ``out`` [h, w, D] the inner products of a view [h, w, C] with another.

    The inner product with a bilinear sample is the bilinear interpolation of four inner products,
    and neighbouring depths mostly share the same four pixels.
    """
    h, w, _ = reference.shape
    row = take(counter)
    while row < h:
        for column in range(w):
            feature = reference[row, column]
            pixel = row * w + column
            top = left = -2
            p00 = p01 = p10 = p11 = np.float32(0)
            for d in range(len(disparities)):
                q = disparities[d]
                z = max(start[2, pixel] + q * offset[2], MIN_DEPTH * q)
                x = (start[0, pixel] + q * offset[0]) / z
                y = (start[1, pixel] + q * offset[1]) / z
                if not (-1 < x < w and -1 < y < h):
                    continue
                column_there, row_there = math.floor(x), math.floor(y)
                if column_there != left or row_there != top:
                    left, top = column_there, row_there
                    p00 = _product(feature, target, top, left)
                    p01 = _product(feature, target, top, left + 1)
                    p10 = _product(feature, target, top + 1, left)
                    p11 = _product(feature, target, top + 1, left + 1)
                a, b = x - left, y - top
                above, below = (1 - a) * p00 + a * p01, (1 - a) * p10 + a * p11
                out[row, column, d] += (1 - b) * above + b * below
        row = take(counter)


@kernel(inline="always", fastmath=FAST_MATH)
def _product(feature, target, row, column):
    """Return the inner product with a pixel of ``target``; 0 outside."""
    total = np.float32(0)
    if 0 <= row < target.shape[0] and 0 <= column < target.shape[1]:
        for c in range(len(feature)):
            total += feature[c] * target[row, column, c]
    return total
