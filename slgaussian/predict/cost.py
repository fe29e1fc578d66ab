"""Matching cost of every pixel at every inverse depth: zero-mean NCC and census, in Numba.

A candidate warps the source view into the reference by its plane-sweep homography (Collins 1996),
so nothing has to be rectified. Windows reach past the border by repeating the border pixel. No
``fastmath``: with it two compilations of this source were seen to give different bytes.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from slgaussian.predict.pose import Relative

OUTSIDE = 60
"""Cost of a candidate that lands outside the source: better than a bad match, worse than a good."""

BLOCK = 16
"""Image rows a thread works on at once, so that its slice of the volume stays in cache."""


def matching_cost(
    ref: np.ndarray,
    src: np.ndarray,
    relative: Relative,
    inverse_depths: np.ndarray,
    zncc_radius: int = 2,
    census_radius: int = 2,
    census_weight: float = 0.4,
) -> np.ndarray:
    """Cost volume of a reference view against one source view.

    Parameters
    ----------
    ref, src : float32 [H, W]
        Grey images, 0 to 255.
    relative : Relative
        From the reference to the source, pixel centres at +0.5.
    inverse_depths : float64 [D]
        Candidates.
    zncc_radius, census_radius : int
        Half sizes of the two square windows.
    census_weight : float
        Share of the census term, 0 to 1; ZNCC gets the rest.

    Returns
    -------
    uint8 [H, W, D]
        0 is a perfect match and 100 an unrelated one, in both terms: ``(1 - ZNCC) * 100`` and the
        share of differing census bits times 200. :data:`OUTSIDE` where a candidate lands outside
        the source or behind it.
    """
    # Kernels count pixel centres at 0: shift once here instead of for every pixel.
    centre = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    away = np.linalg.inv(centre)
    return _matching_cost(
        np.ascontiguousarray(ref, np.float32),
        np.ascontiguousarray(src, np.float32),
        (away @ relative.infinity @ centre).astype(np.float32),
        (away @ relative.epipole).astype(np.float32),
        inverse_depths.astype(np.float32),
        zncc_radius,
        census_radius,
        np.float32(census_weight),
    )


@njit(cache=True)
def _warp_rows(src, A, e, w, y0, rows, radius, out, inside):
    """Rows ``y0 - radius ..`` of the source seen from the reference at inverse depth ``w``.

    ``out`` is [rows + 2 radius, W + 2 radius]; ``inside`` [rows, W] says where the centre of the
    window is inside the source and in front of it.
    """
    H, W = src.shape
    right, bottom = np.float32(W - 1), np.float32(H - 1)
    half = np.float32(0.5)
    zero, one = np.float32(0), np.float32(1)
    for k in range(rows + 2 * radius):
        y = min(max(y0 - radius + k, 0), H - 1)
        bx = A[0, 1] * np.float32(y) + A[0, 2] + w * e[0]
        by = A[1, 1] * np.float32(y) + A[1, 2] + w * e[1]
        bz = A[2, 1] * np.float32(y) + A[2, 2] + w * e[2]
        centre = radius <= k < rows + radius
        for x in range(W):
            fx = np.float32(x)
            z = bz + A[2, 0] * fx
            front = z > np.float32(1e-6)
            scale = one / (z if front else one)
            u = (bx + A[0, 0] * fx) * scale
            v = (by + A[1, 0] * fx) * scale
            if centre:
                inside[k - radius, x] = (
                    front and u >= -half and u <= right + half and v >= -half and v <= bottom + half
                )
            u = min(max(u, zero), right)
            v = min(max(v, zero), bottom)
            j = min(np.int32(u), W - 2)
            i = min(np.int32(v), H - 2)
            du = u - np.float32(j)
            dv = v - np.float32(i)
            top = src[i, j] + du * (src[i, j + 1] - src[i, j])
            low = src[i + 1, j] + du * (src[i + 1, j + 1] - src[i + 1, j])
            out[k, x + radius] = top + dv * (low - top)
        for x in range(radius):
            out[k, x] = out[k, radius]
            out[k, W + radius + x] = out[k, W + radius - 1]


@njit(cache=True)
def _box(values, y, radius, margin, column, out):
    """Sums over the window of each pixel of one row; ``y`` and ``margin`` locate it in the pad."""
    reach = margin - radius
    column[:] = values[y + reach]
    for k in range(1, 2 * radius + 1):
        row = values[y + reach + k]
        for x in range(column.shape[0]):
            column[x] += row[x]
    out[:] = column[reach : reach + out.shape[0]]
    for k in range(1, 2 * radius + 1):
        shifted = column[reach + k : reach + k + out.shape[0]]
        for x in range(out.shape[0]):
            out[x] += shifted[x]


@njit(cache=True, parallel=True)
def _matching_cost(ref, src, A, e, inverse_depths, zncc_radius, census_radius, census_weight):
    H, W = ref.shape
    D = inverse_depths.shape[0]
    volume = np.empty((H, W, D), np.uint8)
    m = max(zncc_radius, census_radius)
    n = np.float32((2 * zncc_radius + 1) ** 2)
    bits = (2 * census_radius + 1) ** 2 - 1
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    most = np.float32(200)
    zncc_share = (one - census_weight) * np.float32(100)
    census_share = census_weight * np.float32(200) / np.float32(bits)
    # A grey level of sensor noise: keeps the correlation of a blank window near 0.
    floor = np.float32(n * 1.0)
    for block in prange((H + BLOCK - 1) // BLOCK):
        y0 = block * BLOCK
        rows = min(BLOCK, H - y0)
        pad = np.empty((rows + 2 * m, W + 2 * m), np.float32)
        for k in range(rows + 2 * m):
            for x in range(W + 2 * m):
                pad[k, x] = ref[min(max(y0 - m + k, 0), H - 1), min(max(x - m, 0), W - 1)]
        warped = np.empty_like(pad)
        product = np.empty_like(pad)
        square = np.empty_like(pad)
        inside = np.empty((rows, W), np.bool_)
        column = np.empty(W + 2 * m, np.float32)
        ref_sum = np.empty((rows, W), np.float32)
        ref_dev = np.empty((rows, W), np.float32)
        sums = np.empty(W, np.float32)
        squares = np.empty(W, np.float32)
        cross = np.empty(W, np.float32)
        differ = np.empty(W, np.int16)
        for k in range(rows + 2 * m):
            for x in range(W + 2 * m):
                square[k, x] = pad[k, x] * pad[k, x]
        for y in range(rows):
            _box(pad, y, zncc_radius, m, column, ref_sum[y])
            _box(square, y, zncc_radius, m, column, ref_dev[y])
            for x in range(W):
                ref_dev[y, x] += floor - ref_sum[y, x] * ref_sum[y, x] / n
        signs = np.empty((bits, rows, W), np.bool_)
        bit = 0
        for dy in range(-census_radius, census_radius + 1):
            for dx in range(-census_radius, census_radius + 1):
                if dy != 0 or dx != 0:
                    for y in range(rows):
                        for x in range(W):
                            signs[bit, y, x] = pad[y + m + dy, x + m + dx] < pad[y + m, x + m]
                    bit += 1
        for d in range(D):
            _warp_rows(src, A, e, inverse_depths[d], y0, rows, m, warped, inside)
            for k in range(rows + 2 * m):
                for x in range(W + 2 * m):
                    product[k, x] = warped[k, x] * pad[k, x]
                    square[k, x] = warped[k, x] * warped[k, x]
            for y in range(rows):
                _box(warped, y, zncc_radius, m, column, sums)
                _box(square, y, zncc_radius, m, column, squares)
                _box(product, y, zncc_radius, m, column, cross)
                for x in range(W):
                    differ[x] = 0
                bit = 0
                for dy in range(-census_radius, census_radius + 1):
                    for dx in range(-census_radius, census_radius + 1):
                        if dy != 0 or dx != 0:
                            near = warped[y + m + dy, m + dx : m + dx + W]
                            centre = warped[y + m, m : m + W]
                            sign = signs[bit, y]
                            for x in range(W):
                                differ[x] += np.int16((near[x] < centre[x]) != sign[x])
                            bit += 1
                mine, dev = ref_sum[y], ref_dev[y]
                for x in range(W):
                    covariance = cross[x] - sums[x] * mine[x] / n
                    deviation = squares[x] + floor - sums[x] * sums[x] / n
                    zncc = covariance / np.sqrt(max(deviation, floor) * max(dev[x], floor))
                    cost = zncc_share * (one - zncc) + census_share * np.float32(differ[x])
                    sums[x] = min(max(cost, zero), most) + half
                for x in range(W):
                    volume[y0 + y, x, d] = sums[x] if inside[y, x] else OUTSIDE
    return volume
