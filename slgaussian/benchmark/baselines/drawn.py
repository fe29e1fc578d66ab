"""Rendering of Gaussians: their colours, and vectors of their source pixels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch

from slgaussian.field import shown
from slgaussian.gaussians import Gaussians
from slgaussian.rasterize import rasterize
from slgaussian.scene import Camera

TOGETHER = 64
"""Feature dimensions rendered in one pass: 490,000 Gaussians then take 125 MB of memory."""

MOST_NUMBERS = 2**26
"""Largest number of elements of a feature image, 256 MB in float32; a larger one is rendered at a
half, a quarter ... of the resolution. At 416 x 576, vectors of 58 dimensions at three scales fit;
those of 512 at one scale are rendered at half resolution."""


class Picture(NamedTuple):
    """A rendered image: rgb uint8 [H, W, 3], alpha float32 [H, W], and z-depth float32 [H, W] in
    scene units, 0 where empty."""

    rgb: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray


def draw_picture(gaussians: Gaussians, camera: Camera) -> Picture:
    """Render the colours of the Gaussians for ``camera``."""
    image = rasterize(gaussians, None, camera)
    alpha = image.alpha.float().numpy()
    return Picture(shown(image.values.float().numpy(), alpha), alpha, image.depth.float().numpy())


def draw_vectors(
    gaussians: Gaussians,
    camera: Camera,
    scales: Sequence[Callable[[np.ndarray, int, int], np.ndarray]],
    width: int,
) -> np.ndarray:
    """Composite the vectors of the Gaussians' source pixels with their blending weights.

    Each of ``scales`` is a function ``at(pixels, start, stop)`` that returns features ``start`` to
    ``stop`` of ``width`` of the given pixels, float32 [n, stop - start], so that not all are in
    memory at once; pixels int64 [n] are flat indices of [V, H, W]. Returns [S, H, W, width].
    """
    source = gaussians.source.numpy()
    images = np.empty((len(scales), camera.height, camera.width, width), np.float32)
    for at, image in zip(scales, images, strict=True):
        for start in range(0, width, TOGETHER):
            stop = min(start + TOGETHER, width)
            values = torch.from_numpy(at(source, start, stop))
            image[..., start:stop] = rasterize(gaussians, values, camera).values.float().numpy()
    return images


def reduced(camera: Camera, numbers: int) -> Camera:
    """Return the camera at full, half, a quarter ... of the resolution, the first at which
    ``numbers`` per pixel do not exceed :data:`MOST_NUMBERS`."""
    factor = 1
    while camera.height * camera.width * numbers > MOST_NUMBERS * factor**2:
        factor *= 2
    return camera.resized(max(camera.width // factor, 1), max(camera.height // factor, 1))
