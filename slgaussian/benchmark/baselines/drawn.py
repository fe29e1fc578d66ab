"""Drawings of Gaussians: their colours, and any vectors that their source pixels carry."""

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
"""Numbers a Gaussian that are drawn in one pass: 490,000 Gaussians take 125 MB of memory then."""

MOST_NUMBERS = 2**26
"""Most numbers of a feature image, 256 MB in float32; a larger one is drawn at a half or a quarter
... of the resolution. Vectors of 58 numbers at three scales fit at 416 x 576, of 512 at one scale a
half."""


class Picture(NamedTuple):
    """A rendered photograph: rgb uint8 [H, W, 3], alpha float32 [H, W], and z-depth float32 [H, W]
    in scene units, 0 where nothing is."""

    rgb: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray


def draw_picture(gaussians: Gaussians, camera: Camera) -> Picture:
    """Draw the colours of the Gaussians as ``camera`` sees them."""
    image = rasterize(gaussians, None, camera)
    alpha = image.alpha.float().numpy()
    return Picture(shown(image.values.float().numpy(), alpha), alpha, image.depth.float().numpy())


def draw_vectors(
    gaussians: Gaussians,
    camera: Camera,
    scales: Sequence[Callable[[np.ndarray, int, int], np.ndarray]],
    width: int,
) -> np.ndarray:
    """Composite what the source pixels of the Gaussians carry, by their fractions of the light.

    ``at(pixels, start, stop)`` of each of the ``scales`` gives these of the ``width`` numbers of
    context pixels int64 [n], flat indices of [V, H, W], as float32 [n, stop - start]: in pieces, so
    that not all are in memory at once. Returns float32 [S, H, W, width].
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
    """Return the camera at the full resolution, a half, a quarter ..., the first at which
    ``numbers`` a pixel keep within :data:`MOST_NUMBERS`."""
    factor = 1
    while camera.height * camera.width * numbers > MOST_NUMBERS * factor**2:
        factor *= 2
    return camera.resized(max(camera.width // factor, 1), max(camera.height // factor, 1))
