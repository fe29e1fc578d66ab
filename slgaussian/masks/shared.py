"""Which pixels of several photographs show the same points, by cameras and predicted depth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from slgaussian.geometry import SeenView

STRIDE = 3
"""Every third pixel of every third row speaks for its neighbours: a crumb still has three."""
COARSE = 4
"""Of these again every fourth in both directions are enough to tell how far two views overlap."""
AGREE_PIXELS = 4.0
"""How far there and back, through the two depth maps, may miss; as in the geometric tracker."""
LOOK = 25.0
"""CIELAB distance at which pixels do not show the same thing, exposure aside."""


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """The points of the surfaces that a photograph shows, on a lattice of its pixels.

    Attributes
    ----------
    seen : SeenView
        With depth.
    """

    seen: SeenView

    @cached_property
    def pixels(self) -> np.ndarray:
        """Index in the flat image of the L pixels of the lattice that have a depth, int64 [L]."""
        return _lattice(self.seen.require_depth(), STRIDE)

    @cached_property
    def few(self) -> np.ndarray:
        """Index in the flat image of those of a coarser lattice, int64."""
        return _lattice(self.seen.require_depth(), STRIDE * COARSE)

    def lifted(self, pixels: np.ndarray) -> np.ndarray:
        """The points float64 [L, 3] in the world at ``pixels`` int64 [L] of the flat image."""
        camera, depth = self.seen.view.camera, self.seen.require_depth()
        row, column = np.divmod(pixels, depth.shape[1])
        rays = np.stack([column + 0.5, row + 0.5, np.ones(len(pixels))], 1)
        rays = rays @ np.linalg.inv(camera.K).T @ camera.c2w[:3, :3].T
        return camera.center + rays * depth.ravel()[pixels, None]


def _lattice(depth: np.ndarray, stride: int) -> np.ndarray:
    rows, columns = np.nonzero(depth[stride // 2 :: stride, stride // 2 :: stride] > 0)
    return (rows * stride + stride // 2) * depth.shape[1] + columns * stride + stride // 2


def met(a: SurfacePoints, b: SurfacePoints, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where view ``b`` shows what ``a`` shows at ``pixels`` int64 [L] of its flat image.

    The pixel that a point falls on must lead back, by the depth of ``b``, and look alike: surfaces
    that hide each other do not, nor do those of another place.

    Returns
    -------
    which : int64 [M]
        The pixels that ``b`` shows too, as rows of ``pixels``.
    place : int64 [M]
        Where, as an index in the flat image of ``b``.
    """
    height, width = b.seen.image.shape[:2]
    landed, z = b.seen.view.camera.project(a.lifted(pixels))
    inside = (z > 0) & (landed >= 0).all(1) & (landed < (width, height)).all(1)
    which = np.flatnonzero(inside)
    column, row = landed[which].astype(np.int64).T
    place = row * width + column
    back, z = a.seen.view.camera.project(b.lifted(place))
    row, column = np.divmod(pixels[which], a.seen.image.shape[1])
    error = np.hypot(back[:, 0] - column - 0.5, back[:, 1] - row - 0.5)
    same = (b.seen.require_depth().ravel()[place] > 0) & (z > 0) & (error <= AGREE_PIXELS)
    which, place = which[same], place[same]
    gap = _lab(a, pixels[which]) - _lab(b, place)
    if len(which):
        gap -= np.median(gap, 0)  # another exposure or white balance is no other thing
    alike = np.linalg.norm(gap, axis=1) < LOOK
    return which[alike], place[alike]


def overlap(a: SurfacePoints, b: SurfacePoints) -> float:
    """Share of what view ``a`` shows that ``b`` shows too, of a few points."""
    return len(met(a, b, a.few)[0]) / max(len(a.few), 1)


def _lab(points: SurfacePoints, pixels: np.ndarray) -> np.ndarray:
    return points.seen.view.lab.reshape(-1, 3)[pixels]
