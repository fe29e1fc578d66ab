"""Correlation of ``cost_volume`` on the CPU by interpolation of inner products, without warping.

The inner product with a bilinear sample is the bilinear interpolation of four inner products, and
neighbouring depths mostly share the same four pixels.
"""

from __future__ import annotations

import math

import numpy as np

from slgaussian.kernels.jit import kernel
from slgaussian.kernels.work_sharing import take

REORDERED = {"reassoc", "contract", "nsz"}
"""Fast-math flags for sums, without those that assume away NaN and infinity."""


@kernel(fastmath=REORDERED)
def add_products(counter, start, offset, min_depth, reference, target, disparities, out):
    """Add to ``out`` the inner products of a view with another at every disparity.

    A row of ``out`` is a work item.

    Args:
        start, offset: float32 [3, h * w], [3]. At disparity ``q`` the homogeneous position of a
            pixel is ``start + q offset``.
        min_depth: float32. Lower bound of depth in the target view.
        reference, target: float32 [h, w, C]
        disparities: float32 [D]
        out: float32 [h, w, D]
    """
    h, w, _ = reference.shape
    row = take(counter)
    while row < h:
        for column in range(w):
            feature = reference[row, column]
            pixel = row * w + column
            top = left = -2
            p00 = p01 = p10 = p11 = np.float32(0)
            for d in range(len(disparities)):
                q = disparities[d]
                z = max(start[2, pixel] + q * offset[2], min_depth * q)
                x = (start[0, pixel] + q * offset[0]) / z
                y = (start[1, pixel] + q * offset[1]) / z
                if not (-1 < x < w and -1 < y < h):
                    continue
                column_there, row_there = math.floor(x), math.floor(y)
                if column_there != left or row_there != top:
                    left, top = column_there, row_there
                    p00 = _product(feature, target, top, left)
                    p01 = _product(feature, target, top, left + 1)
                    p10 = _product(feature, target, top + 1, left)
                    p11 = _product(feature, target, top + 1, left + 1)
                a, b = x - left, y - top
                above, below = (1 - a) * p00 + a * p01, (1 - a) * p10 + a * p11
                out[row, column, d] += (1 - b) * above + b * below
        row = take(counter)


@kernel(inline="always", fastmath=REORDERED)
def _product(feature, target, row, column):
    """Return the inner product with a pixel of ``target``; 0 outside."""
    total = np.float32(0)
    if 0 <= row < target.shape[0] and 0 <= column < target.shape[1]:
        for c in range(len(feature)):
            total += feature[c] * target[row, column, c]
    return total
