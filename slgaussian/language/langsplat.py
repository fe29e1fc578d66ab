"""How LangSplat (arXiv 2312.16084) turns a relevancy image into a mask and a place.

Facts from the published evaluation (`evaluate_iou_loc.py`), written anew. There the image comes
from a network a pixel and is noisy; here it is one number an object, so that the maximum is a
plateau and sums must be exact, or rounding would choose among its pixels. Relevancies are therefore
rounded to 2^-30 and added as whole numbers.

With three granularities LangSplat takes the one whose smoothed image is highest. A field has one.
"""

from __future__ import annotations

import numpy as np

FILTER = 30
"""Side of the mean filter, pixels; its window lies from -15 to +14 around a pixel."""

MASK_THRESHOLD = 0.4
"""Of the image stretched to [-1, 1]: 0.7 of its range."""

MAJORITY = 7
"""Side of the window in which most pixels must be set for a pixel of the mask."""

_STEPS = 2**30


def smoothed(relevancy: np.ndarray) -> np.ndarray:
    """Mean over :data:`FILTER` squared, the image mirrored at its edges without repeating them.

    float64 [H, W] of float [H, W] in [0, 1], within 2^-30, equal where windows hold equal values.
    """
    steps = np.rint(relevancy.astype(np.float64) * _STEPS).astype(np.int64)
    before, after = FILTER // 2, FILTER - FILTER // 2 - 1
    for axis in (0, 1):
        steps = _mirrored(steps, before, after, axis)
    return _window_sums(steps, FILTER) / (_STEPS * FILTER**2)


def find_mask(relevancy: np.ndarray) -> np.ndarray:
    """The mask bool [H, W] of a relevancy image: smoothed, stretched, cut, cleaned.

    The mean of the image and its :func:`smoothed` is stretched to [-1, 1], negative values are
    cut off, and what is above :data:`MASK_THRESHOLD` is kept where it has the majority of the
    :data:`MAJORITY` squared around (of what the image has of it). An image of one value gives an
    empty mask.
    """
    blend = 0.5 * (smoothed(relevancy) + relevancy)
    low, high = blend.min(), blend.max()
    stretched = (blend - low) / (high - low + 1e-9)
    return _most_around(np.clip(2 * stretched - 1, 0, 1) > MASK_THRESHOLD)


def find_point(relevancy: np.ndarray) -> tuple[tuple[int, int], np.ndarray]:
    """Where the :func:`smoothed` image is greatest: one pixel (x, y), and all of them [H, W].

    LangSplat counts a hit if *any* of them lies in a box of the truth, which a plateau that spans
    the picture would always do. The one pixel is that of the plateau nearest its centroid, the
    first in row-major order of several.
    """
    values = smoothed(relevancy)
    plateau = values == values.max()
    rows, columns = np.nonzero(plateau)
    n = len(rows)
    # Times n, so that all are whole numbers and equally near ones tie.
    squared = (n * rows - rows.sum()) ** 2 + (n * columns - columns.sum()) ** 2
    best = int(squared.argmin())
    return (int(columns[best]), int(rows[best])), plateau


def _most_around(mask: np.ndarray) -> np.ndarray:
    """Where more than half of the window that is in the image is set."""
    half = MAJORITY // 2
    inside = np.pad(np.ones(mask.shape, np.int64), half)
    return 2 * _window_sums(np.pad(mask.astype(np.int64), half), MAJORITY) > _window_sums(
        inside, MAJORITY
    )


def _mirrored(values: np.ndarray, before: int, after: int, axis: int) -> np.ndarray:
    """Rows (or columns) reflected about the first and the last, also where there are few."""
    n = values.shape[axis]
    period = max(2 * (n - 1), 1)
    place = np.arange(-before, n + after) % period
    return values.take(np.where(place < n, place, period - place), axis)


def _window_sums(values: np.ndarray, side: int) -> np.ndarray:
    """Sums over all windows of ``side`` squared of whole numbers, exact."""
    total = np.zeros((values.shape[0] + 1, values.shape[1] + 1), np.int64)
    total[1:, 1:] = values.cumsum(0).cumsum(1)
    return total[side:, side:] - total[:-side, side:] - total[side:, :-side] + total[:-side, :-side]
