"""Correspondences between pixels of several photographs by cameras and predicted depth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from slgaussian.geometry import SeenView

STRIDE = 3
"""Spacing of the lattice of pixels: a crumb still contains three."""
COARSE_STRIDE = 4
"""Spacing of the coarser lattice, in points of the finer one, that measures overlap."""
AGREE_PIXELS = 4.0
"""Largest forward-backward reprojection error of corresponding pixels. With 2 and with 8, the
geometric tracker matches fewer objects or pixels."""
MAX_COLOUR_DISTANCE = 25.0
"""Largest CIELAB distance of corresponding pixels, after compensation of exposure."""


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Surface points of a photograph on a lattice of its pixels.

    Attributes:
        frame: With depth.
    """

    frame: SeenView

    @cached_property
    def lab(self) -> np.ndarray:
        """CIELAB float32 [H, W, 3] by which colours are compared."""
        return self.frame.view.lab

    def pixels(self, stride: int = STRIDE) -> np.ndarray:
        """Return indices in the flat image of the L lattice pixels with depth, int64 [L]."""
        depth, first = self.frame.require_depth(), stride // 2
        rows, columns = np.nonzero(depth[first::stride, first::stride] > 0)
        return (rows * stride + first) * depth.shape[1] + columns * stride + first

    def unproject(self, pixels: np.ndarray) -> np.ndarray:
        """Unproject ``pixels`` int64 [L] of the flat image to world points, float64 [L, 3]."""
        camera, depth = self.frame.view.camera, self.frame.require_depth()
        row, column = np.divmod(pixels, depth.shape[1])
        rays = np.stack([column + 0.5, row + 0.5, np.ones(len(pixels))], 1)
        rays = rays @ np.linalg.inv(camera.K).T @ camera.c2w[:3, :3].T
        return camera.center + rays * depth.ravel()[pixels, None]


def match_points(
    a: SurfacePoints, b: SurfacePoints, pixels: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find the pixels of view ``b`` that correspond to ``pixels`` int64 [L] of view ``a``.

    They must pass the depth test of :func:`reproject`, which rejects occluded surfaces, and have a
    similar colour, which rejects surfaces of another place.

    Returns:
        which: int64 [M]. Indices of the matched elements of ``pixels``.
        place: int64 [M]. Their pixels as indices in the flat image of ``b``.
    """
    which, place = reproject(a, b, pixels)
    gap = a.lab.reshape(-1, 3)[pixels[which]] - b.lab.reshape(-1, 3)[place]
    if len(which):
        gap -= np.median(gap, 0)  # compensates exposure and white balance
    similar = np.linalg.norm(gap, axis=1) < MAX_COLOUR_DISTANCE
    return which[similar], place[similar]


def reproject(
    a: SurfacePoints, b: SurfacePoints, pixels: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find the pixels of ``b`` that points of ``a`` project to and that project back by depth.

    Arguments and results are those of :func:`match_points`.
    """
    camera = b.frame.view.camera
    projected, z = camera.project(a.unproject(pixels))
    which = np.flatnonzero(camera.shows(projected, z))
    column, row = projected[which].astype(np.int64).T
    place = row * camera.width + column
    back, z = a.frame.view.camera.project(b.unproject(place))
    row, column = np.divmod(pixels[which], a.frame.image.shape[1])
    error = np.hypot(back[:, 0] - column - 0.5, back[:, 1] - row - 0.5)
    same = (b.frame.require_depth().ravel()[place] > 0) & (z > 0) & (error <= AGREE_PIXELS)
    return which[same], place[same]


def overlap(a: SurfacePoints, b: SurfacePoints) -> float:
    """Estimate the fraction of the surface in view ``a`` that is visible in ``b``."""
    pixels = a.pixels(STRIDE * COARSE_STRIDE)
    return len(match_points(a, b, pixels)[0]) / max(len(pixels), 1)
