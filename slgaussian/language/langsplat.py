"""The mask and the place that LangSplat (arXiv 2312.16084) takes from a relevancy image.

Facts from the published evaluation (`evaluate_iou_loc.py`), written anew. There the image comes
from a network a pixel and is noisy; here it is one number an object, so that the maximum is a
plateau and sums must be exact, or rounding would choose among its pixels. Relevancies are therefore
rounded to 2^-30 and added as whole numbers.

With three granularities LangSplat takes the one whose smoothed image is highest. A field has one.
"""

from __future__ import annotations

import cv2
import numpy as np

FILTER = 30
"""Side of the mean filter, pixels; its window lies from -15 to +14 around a pixel."""

FILTER_WIDTH = 988
"""Width of the images that :data:`FILTER` was chosen for, those of LERF."""

MASK_THRESHOLD = 0.4
"""Bound in the image stretched to [-1, 1]: 0.7 of its range."""

MAJORITY = 7
"""Side of the window in which most pixels must be set for a pixel of the mask."""

_STEPS = 2**30


def rescaled_filter(width: int) -> int:
    """The side that covers as much of an image ``width`` pixels wide as 30 of LERF's do."""
    return max(1, round(FILTER * width / FILTER_WIDTH))


def smoothed(relevancy: np.ndarray, side: int = FILTER) -> np.ndarray:
    """Mean over ``side`` squared, the image mirrored at its edges without repeating them.

    float64 [H, W] of float [H, W] in [0, 1], within 2^-30, equal where windows hold equal values.
    """
    # Whole numbers whose sums stay below 2^53 are added exactly in float64, in any order.
    steps = np.rint(relevancy.astype(np.float64) * _STEPS)
    window = (side, side)
    sums = cv2.boxFilter(steps, -1, window, normalize=False, borderType=cv2.BORDER_REFLECT_101)
    return sums / (_STEPS * side**2)


def find_mask(relevancy: np.ndarray, side: int = FILTER) -> np.ndarray:
    """The mask bool [H, W] of a relevancy image: smoothed, stretched, cut, cleaned.

    The mean of the image and its :func:`smoothed` is stretched to [-1, 1], negative values are
    cut off, and what is above :data:`MASK_THRESHOLD` is kept where it has the majority of the
    :data:`MAJORITY` squared around, of what the image has of it. The last row and column of the
    image have no say there: the published code leaves them out of every window. An image of one
    value gives an empty mask.
    """
    blend = 0.5 * (smoothed(relevancy, side) + relevancy)
    low, high = blend.min(), blend.max()
    stretched = (blend - low) / (high - low + 1e-9)
    return _most_around(np.clip(2 * stretched - 1, 0, 1) > MASK_THRESHOLD)


def find_point(relevancy: np.ndarray, side: int = FILTER) -> tuple[tuple[int, int], np.ndarray]:
    """Find where the :func:`smoothed` image is greatest: a pixel (x, y), and all bool [H, W].

    LangSplat counts a hit if *any* of them lies in a box of the truth, which a plateau that spans
    the picture would always do. The one pixel is that of the plateau nearest its centroid, the
    first in row-major order of several.
    """
    values = smoothed(relevancy, side)
    plateau = values == values.max()
    rows, columns = np.nonzero(plateau)
    n = len(rows)
    # Times n, so that all are whole numbers and equally near ones tie.
    squared = (n * rows - rows.sum()) ** 2 + (n * columns - columns.sum()) ** 2
    best = int(squared.argmin())
    return (int(columns[best]), int(rows[best])), plateau


def _most_around(mask: np.ndarray) -> np.ndarray:
    """Find the pixels around which more than half of the window is set."""
    set_, voting = mask.astype(np.float32), np.ones(mask.shape, np.float32)
    for image in (set_, voting):
        image[-1], image[:, -1] = 0, 0
    around, of = (
        cv2.boxFilter(
            image, -1, (MAJORITY, MAJORITY), normalize=False, borderType=cv2.BORDER_CONSTANT
        )
        for image in (set_, voting)
    )
    return 2 * around > of
