"""Mask and localisation of LangSplat's evaluation (arXiv 2312.16084) from a relevancy image.

A clean-room implementation of the protocol in `evaluate_iou_loc.py`. There the image is predicted
per pixel and is noisy; here it has one value per object, so the maximum is a plateau and rounding
errors would choose among its pixels. Relevancies are therefore rounded to multiples of 2^-30, whose
sums are exact.

LangSplat takes, of three granularities, the one with the highest smoothed value. A field has one.
"""

from __future__ import annotations

import cv2
import numpy as np

FILTER_SIDE = 30
"""Side of the mean filter, pixels; its window extends from -15 to +14 around a pixel."""

FILTER_IMAGE_WIDTH = 988
"""Width of LERF's images, for which :data:`FILTER_SIDE` was chosen, pixels."""

MASK_THRESHOLD = 0.4
"""Threshold of the mask after rescaling to [-1, 1], i.e. at 0.7 of the range."""

MAJORITY_SIDE = 7
"""Side of the window of the majority filter of masks, pixels."""

_STEPS = 2**30


def rescaled_filter(width: int) -> int:
    """Scale :data:`FILTER_SIDE` to an image ``width`` pixels wide."""
    return max(1, round(FILTER_SIDE * width / FILTER_IMAGE_WIDTH))


def smooth(relevancy: np.ndarray, side: int = FILTER_SIDE) -> np.ndarray:
    """Apply a ``side`` x ``side`` mean filter with mirrored borders (BORDER_REFLECT_101).

    Takes float [H, W] in [0, 1]; returns float64 [H, W], accurate to 2^-30 and exactly equal for
    windows with equal values.
    """
    # Sums of integers below 2^53 are exact in float64, in any order.
    steps = np.rint(relevancy.astype(np.float64) * _STEPS)
    window = (side, side)
    sums = cv2.boxFilter(steps, -1, window, normalize=False, borderType=cv2.BORDER_REFLECT_101)
    return sums / (_STEPS * side**2)


def find_mask(relevancy: np.ndarray, side: int = FILTER_SIDE) -> np.ndarray:
    """Compute the mask bool [H, W] of a relevancy image: smooth, rescale, threshold, clean.

    The mean of the image and its :func:`smooth` version is rescaled to [-1, 1] and thresholded at
    :data:`MASK_THRESHOLD`; a :data:`MAJORITY_SIDE`-sided majority filter cleans the result. As in
    the published code, windows end at the image border and exclude the last row and column. A
    constant image gives an empty mask.
    """
    blend = 0.5 * (smooth(relevancy, side) + relevancy)
    low, high = blend.min(), blend.max()
    stretched = (blend - low) / (high - low + 1e-9)
    return _majority_filter(np.clip(2 * stretched - 1, 0, 1) > MASK_THRESHOLD)


def find_point(
    relevancy: np.ndarray, side: int = FILTER_SIDE
) -> tuple[tuple[int, int], np.ndarray]:
    """Find the maximum of the :func:`smooth` image: one pixel (x, y), and the plateau [H, W].

    LangSplat counts a hit if *any* maximal pixel lies in a ground-truth box, which a plateau over
    the whole picture always satisfies. The single pixel is the one of the plateau nearest to its
    centroid; ties go to the first in row-major order.
    """
    values = smooth(relevancy, side)
    plateau = values == values.max()
    rows, columns = np.nonzero(plateau)
    n = len(rows)
    # Multiplied by n, so that all values are integers and ties are exact.
    squared = (n * rows - rows.sum()) ** 2 + (n * columns - columns.sum()) ** 2
    best = int(squared.argmin())
    return (int(columns[best]), int(rows[best])), plateau


def _majority_filter(mask: np.ndarray) -> np.ndarray:
    """Return the pixels with more than half of the window set, bool [H, W]."""
    votes, valid = mask.astype(np.float32), np.ones(mask.shape, np.float32)
    for image in (votes, valid):
        image[-1], image[:, -1] = 0, 0
    count, total = (
        cv2.boxFilter(
            image,
            -1,
            (MAJORITY_SIDE, MAJORITY_SIDE),
            normalize=False,
            borderType=cv2.BORDER_CONSTANT,
        )
        for image in (votes, valid)
    )
    return 2 * count > total
