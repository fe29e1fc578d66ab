"""Cost volume: feature correlation of every pixel with other views at every candidate depth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F

from slgaussian.kernels.work_sharing import share
from slgaussian.predict.mvsplat.cost_volume_cpu import add_products
from slgaussian.scene import Camera

CHUNK = 1024
"""Pixels warped at a time: their samples at all depths take 64 MB; those of a full image would take
a gigabyte."""

MIN_DEPTH = 1e-3
"""Lower bound of depth in the target view, against division by zero."""


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
    for i in range(views):
        for j in (j for j in range(views) if j != i):
            lines = path(cameras[i], cameras[j], (h, w))
            if volume.is_cpu:
                arrays = (t.numpy() for t in (maps[i], maps[j], disparities, volume[i]))
                share(add_products, h, *lines, np.float32(MIN_DEPTH), *arrays)
            else:
                add_warped(*lines, maps[i], maps[j], disparities, volume[i])
    volume *= 1 / (channels**0.5 * (views - 1))
    return volume


def path(reference: Camera, target: Camera, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the epipolar paths of pixels of ``reference`` in ``target``, maps of ``size`` (h, w).

    Returns:
        start, offset: float32 [3, h * w], [3]. At disparity ``q`` the homogeneous position is
            ``start + q offset``; its third component is the depth in ``target`` over that in
            ``reference``.
    """
    h, w = size
    K_reference, K_target = reference.resized(w, h).K, target.resized(w, h).K
    motion = target.w2c @ reference.c2w
    v, u = np.mgrid[:h, :w].reshape(2, -1).astype(np.float64)
    pixels = np.stack([u, v, np.ones_like(u)])
    start = K_target @ motion[:3, :3] @ np.linalg.inv(K_reference) @ pixels
    return start.astype(np.float32), (K_target @ motion[:3, 3]).astype(np.float32)


def positions(
    start: np.ndarray, offset: np.ndarray, disparities: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the pixels x and y of P paths at D disparities, float32 [P, D] each."""
    columns = torch.from_numpy(np.ascontiguousarray(start)).to(disparities.device)[..., None]
    x, y, z = (c + disparities * s for c, s in zip(columns, offset.tolist(), strict=True))
    z = torch.maximum(z, MIN_DEPTH * disparities)
    return x.div_(z), y.div_(z)


def add_warped(
    start: np.ndarray,
    offset: np.ndarray,
    reference: torch.Tensor,
    target: torch.Tensor,
    disparities: torch.Tensor,
    out: torch.Tensor,
) -> None:
    """Add to ``out`` [h, w, D] the products of ``reference`` and ``target`` [h, w, C].

    The definition of ``cost_volume_cpu.add_products``, on any device.
    """
    h, w, channels = reference.shape
    x, y = positions(start, offset, disparities)
    # ``grid_sample`` has the outermost pixel centres at -1 and 1. It gives 0 beyond one pixel
    # outside, and NaN for infinite positions, which are therefore clamped.
    grid = torch.stack([x / (w - 1), y / (h - 1)], -1).mul_(2).sub_(1).clamp_(-3, 3)
    maps, references = target.permute(2, 0, 1)[None], reference.view(h * w, channels)
    products = out.view(h * w, -1)
    for first in range(0, h * w, CHUNK):
        part = slice(first, first + CHUNK)
        warped = F.grid_sample(maps, grid[None, part], align_corners=True)[0]
        products[part] += torch.einsum("pc,cpd->pd", references[part], warped)
