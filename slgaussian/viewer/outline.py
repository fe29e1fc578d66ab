"""The outline of a thing in space: its Gaussians beside those of others, in the photograph of each.

So the outline is there from wherever one looks, and showing it sends no more than the colours of
the thing. Where a thing goes beyond the edge of a photograph it has none.
"""

from __future__ import annotations

import cv2
import numpy as np

WIDTH = 2
"""Pixels of the photographs within which a Gaussian of another thing makes one belong to the
outline. Not all pixels have a Gaussian."""


class Outlines:
    """The outlines of things of one scene.

    Parameters
    ----------
    labels : int32 [N]
        Thing of each Gaussian, 0 for none.
    source : int [N]
        The pixel that each was made of, counted through all photographs.
    shape : (V, H, W)
        How many photographs, and their size.
    """

    def __init__(self, labels: np.ndarray, source: np.ndarray, shape: tuple[int, int, int]) -> None:
        self._labels, self._source = labels, source.astype(np.int64)
        flat = np.full(int(np.prod(shape)), -1, np.int32)
        flat[self._source] = labels
        self._seen = flat.reshape(shape)

    def of(self, thing: int) -> np.ndarray:
        """bool [N]: the Gaussians of the outline of a thing; they are its own."""
        mine = self._seen == thing
        window = np.ones((2 * WIDTH + 1, 2 * WIDTH + 1), np.uint8)
        edge = np.zeros(mine.shape, bool)
        for own, seen, out in zip(mine, self._seen, edge, strict=True):
            if own.any():
                others = (~own & (seen >= 0)).astype(np.uint8)
                out[:] = own & (cv2.dilate(others, window) > 0)
        outline: np.ndarray = edge.ravel()[self._source] & (self._labels == thing)
        return outline
