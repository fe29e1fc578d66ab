"""The correlation of ``cost_volume`` for processors: nothing is warped, products are interpolated.

The inner product with a bilinear sample is the bilinear interpolation of four inner products, and
neighbouring depths mostly fall between the same four pixels.
"""

from __future__ import annotations

import math

import numpy as np

from slgaussian.kernels.jit import kernel
from slgaussian.kernels.work_sharing import take

REORDERED = {"reassoc", "contract", "nsz"}
"""Freedoms of the compiler with sums; those about NaN and infinity are not among them."""


@kernel(fastmath=REORDERED)
def add_products(counter, start, offset, least, reference, other, disparities, out):
    """Add to ``out`` the inner products of a view with another at every disparity.

    A row of ``out`` is a portion.

    Parameters
    ----------
    start, offset : float32 [3, h * w], [3]
        At disparity ``q`` a pixel lands on the homogeneous ``start + q offset``.
    least : float32
        Least depth in the other view.
    reference, other : float32 [h, w, C]
    disparities : float32 [D]
    out : float32 [h, w, D]
    """
    h, w, _ = reference.shape
    row = take(counter)
    while row < h:
        for column in range(w):
            mine = reference[row, column]
            pixel = row * w + column
            top = left = -2
            p00 = p01 = p10 = p11 = np.float32(0)
            for d in range(len(disparities)):
                q = disparities[d]
                z = max(start[2, pixel] + q * offset[2], least * q)
                x = (start[0, pixel] + q * offset[0]) / z
                y = (start[1, pixel] + q * offset[1]) / z
                if not (-1 < x < w and -1 < y < h):
                    continue
                column_there, row_there = math.floor(x), math.floor(y)
                if column_there != left or row_there != top:
                    left, top = column_there, row_there
                    p00 = _product(mine, other, top, left)
                    p01 = _product(mine, other, top, left + 1)
                    p10 = _product(mine, other, top + 1, left)
                    p11 = _product(mine, other, top + 1, left + 1)
                a, b = x - left, y - top
                above, below = (1 - a) * p00 + a * p01, (1 - a) * p10 + a * p11
                out[row, column, d] += (1 - b) * above + b * below
        row = take(counter)


@kernel(inline="always", fastmath=REORDERED)
def _product(mine, other, row, column):
    """Inner product with a pixel of ``other``; 0 outside."""
    total = np.float32(0)
    if 0 <= row < other.shape[0] and 0 <= column < other.shape[1]:
        for c in range(len(mine)):
            total += mine[c] * other[row, column, c]
    return total
