"""The tracker that knows where things are: labels reprojected through the predicted depth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slgaussian.errors import InputError
from slgaussian.masks.memory import Frame, MemoryTracker, both_ways
from slgaussian.masks.shared import SurfacePoints, overlap

if TYPE_CHECKING:
    from slgaussian.geometry import SeenView

AGREE_PIXELS = 4.0
"""How far there and back, through the two depth maps, may miss: what is hidden misses by far, what
is a little off in one of them by little, and by less where depth moves a pixel less. With 2 and
with 8, fewer objects or pixels are matched."""


class GeometricTracker(MemoryTracker):
    """Matches a remembered frame with a new one by their cameras and predicted depths.

    A pixel of the new view is lifted by its own depth and projected into the old one. The pixel it
    meets there must lead back, by that view's depth: surfaces that hide each other do not. Given
    poses will do where a predictor used better ones: its depths then land a little off, which
    tolerance and leaves forgive. The rest is :class:`slgaussian.masks.memory.MemoryTracker`.
    """

    def describe(self, seen: SeenView, labels: np.ndarray) -> Frame:
        """Refuse a view without depth; see :class:`slgaussian.masks.memory.MemoryTracker`."""
        if seen.depth is None:
            raise InputError(
                f"tracker 'geometric': view {seen.view.name!r} comes without predicted depth; give "
                "depths"
            )
        return super().describe(seen, labels)

    def match(self, new: Frame, old: Frame) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`slgaussian.masks.memory.MemoryTracker.match`."""
        return both_ways(_seen_from(new, old), _seen_from(old, new), AGREE_PIXELS, 0)

    def shows(self, new: Frame, old: Frame) -> float:
        """The share of a few points; see :meth:`slgaussian.masks.memory.MemoryTracker.shows`."""
        return overlap(SurfacePoints(new.seen), SurfacePoints(old.seen))


def _seen_from(frame: Frame, other: Frame) -> np.ndarray:
    """Where each pixel of ``frame`` lies in ``other``, float64 [H, W, 2]; NaN where unknown."""
    depth = frame.seen.require_depth()
    points = frame.seen.view.camera.unproject(depth)
    pixels, z = other.seen.view.camera.project(points)
    pixels[(depth <= 0) | (z <= 0)] = np.nan
    return pixels - 0.5
