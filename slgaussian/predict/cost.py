"""Matching cost of every pixel at every inverse depth: zero-mean NCC and census, in Numba.

A candidate warps the source view into the reference by its plane-sweep homography (Collins 1996),
without rectification. Windows are padded at the border by replication.

The loops over x vectorise: one gather for each warped pixel, constant window sizes, and contiguous
costs of one candidate within a block. No ``fastmath``: with it two compilations of this source gave
different bytes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba.extending import intrinsic

from slgaussian.cameras.relative import Relative
from slgaussian.kernels.jit import kernel
from slgaussian.kernels.work_sharing import share, take

OUTSIDE_COST = 60
"""Cost of a candidate outside the source image: between a bad match and a good one."""

RADIUS = 2
"""Half the side of the square window of both terms."""

CENSUS_WEIGHT = 0.4

BLOCK_ROWS = 16
"""Image rows of a work item, so that its slice of the volume stays in cache."""

_SIDE = 2 * RADIUS + 1
_AREA = np.float32(_SIDE**2)
# Variance of one grey level of sensor noise: keeps the correlation of a blank window near 0.
_FLOOR = np.float32(_SIDE**2)


def matching_costs(
    ref: np.ndarray,
    sources: Sequence[tuple[np.ndarray, Relative]],
    inverse_depths: np.ndarray,
    census_weight: float = CENSUS_WEIGHT,
) -> np.ndarray:
    """Compute the cost volumes of a reference view against S source views.

    Args:
        ref: uint8 [H, W]. Grey image.
        sources: sequence of S (uint8 [H, W], Relative). Grey image, and pose from the reference to
            the source, pixel centres at +0.5.
        inverse_depths: float64 [D]. Candidates.
        census_weight: Weight of the census term, 0 to 1; ZNCC has the rest.

    Returns:
        uint8 [S, H, W, D]: 0 is a perfect match and 100 an unrelated one, in both terms: ``(1 -
            ZNCC) * 100`` and the share of differing census bits times 200. :data:`OUTSIDE_COST`
            where a candidate lands outside the source or behind it.
    """
    # Kernels have pixel centres at integers: shift once here instead of for every pixel.
    centre = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    inverse = np.linalg.inv(centre)
    volumes = np.empty((len(sources), *ref.shape, len(inverse_depths)), np.uint8)
    padded = np.pad(ref, RADIUS, mode="edge").astype(np.float32)
    for (src, relative), volume in zip(sources, volumes, strict=True):
        share(
            _matching_cost,
            -(-len(volume) // BLOCK_ROWS),
            padded,
            _squares(src),
            (inverse @ relative.infinity @ centre).astype(np.float32),
            (inverse @ relative.epipole).astype(np.float32),
            inverse_depths.astype(np.float32),
            np.float32((1 - census_weight) * 100),
            np.float32(census_weight * 200 / (_SIDE**2 - 1)),
            volume,
        )
    return volumes


def combine_costs(costs: np.ndarray) -> np.ndarray:
    """Combine cost volumes uint8 [S, H, W, D] to the mean of the better half, uint8 [H, W, D].

    The better half is robust to occlusion in some sources; the minimum alone would reward
    accidental matches. Sources with the candidate outside the image are ignored, unless all are.
    """
    if len(costs) == 1:
        return costs[0]
    out = np.empty_like(costs[0])
    share(_combine, len(out), costs, out)
    return out


@kernel
def _combine(counter, costs, out):
    S, H, W, D = costs.shape
    sorted_costs = np.empty(S, np.int32)
    y = take(counter)
    while y < H:
        for x in range(W):
            for d in range(D):
                count = 0
                for s in range(S):
                    cost = np.int32(costs[s, y, x, d])
                    if cost == OUTSIDE_COST:
                        continue
                    k = count
                    while k > 0 and sorted_costs[k - 1] > cost:
                        sorted_costs[k] = sorted_costs[k - 1]
                        k -= 1
                    sorted_costs[k] = cost
                    count += 1
                if count == 0:
                    out[y, x, d] = OUTSIDE_COST
                    continue
                half = min(count, (S + 1) // 2)
                total = half // 2
                for k in range(half):
                    total += sorted_costs[k]
                out[y, x, d] = total // half
        y = take(counter)


def _squares(image: np.ndarray) -> np.ndarray:
    """Pack each pixel with its right, lower and lower right neighbours into uint32 [H, W]."""
    wide = np.pad(image, ((0, 1), (0, 1)), mode="edge").astype(np.uint32)
    return wide[:-1, :-1] | wide[:-1, 1:] << 8 | wide[1:, :-1] << 16 | wide[1:, 1:] << 24


@intrinsic
def _count_ones(typing, bits):
    """Count the bits set in an integer."""
    return bits(bits), lambda context, builder, signature, args: builder.ctpop(args[0])


@kernel
def _warp_row(squares, A, e, w, y, at, du, dv, out, inside):
    """Warp the source into row ``y`` of the reference at inverse depth ``w``: ``out`` [W], and
    whether ``inside`` [W] the source; ``at``, ``du`` and ``dv`` are scratch."""
    H, W = squares.shape
    flat = squares.ravel()
    right, bottom = np.float32(W - 1), np.float32(H - 1)
    half = np.float32(0.5)
    zero, unity = np.float32(0), np.float32(1)
    ax, ay, az = A[0, 0], A[1, 0], A[2, 0]
    base_x = A[0, 1] * np.float32(y) + A[0, 2] + w * e[0]
    base_y = A[1, 1] * np.float32(y) + A[1, 2] + w * e[1]
    base_z = A[2, 1] * np.float32(y) + A[2, 2] + w * e[2]
    for x in range(W):
        fx = np.float32(np.int32(x))
        z = base_z + az * fx
        front = z > np.float32(1e-6)
        scale = unity / (z if front else unity)
        u = (base_x + ax * fx) * scale
        v = (base_y + ay * fx) * scale
        inside[x] = front & (u >= -half) & (u <= right + half) & (v >= -half) & (v <= bottom + half)
        u = min(max(u, zero), right)
        v = min(max(v, zero), bottom)
        j, i = np.int32(u), np.int32(v)
        du[x] = u - np.float32(j)
        dv[x] = v - np.float32(i)
        at[x] = i * np.int32(W) + j
    byte = np.uint32(255)
    for x in range(W):
        square = flat[np.uint32(at[x])]
        a = np.float32(np.int32(square & byte))
        b = np.float32(np.int32((square >> np.uint32(8)) & byte))
        c = np.float32(np.int32((square >> np.uint32(16)) & byte))
        d = np.float32(np.int32(square >> np.uint32(24)))
        top = a + du[x] * (b - a)
        low = c + du[x] * (d - c)
        out[x] = top + dv[x] * (low - top)


@kernel(inline="always")
def _census(rows, x):
    """Return a bit for each pixel of a window darker than the centre; a call is not vectorised."""
    bits = np.uint32(0)
    centre = rows[RADIUS, x + RADIUS]
    for j in range(_SIDE):
        for i in range(_SIDE):
            if j != RADIUS or i != RADIUS:
                bits = np.uint32(bits + bits + np.uint32(rows[j, x + i] < centre))
    return bits


@kernel
def _row_cost(near, target_rows, total, deviation, bits, zncc_share, census_share, columns, cost):
    """Compute the costs of a row from rows ``near`` of the warped source and ``target_rows`` of the
    reference, whose window sums, variances and census bits are given; ``columns`` is scratch."""
    W = cost.shape[0]
    sums, squares, products = columns[0], columns[1], columns[2]
    for x in range(W + 2 * RADIUS):
        s = q = p = np.float32(0)
        for j in range(_SIDE):
            s += near[j, x]
            q += near[j, x] * near[j, x]
            p += near[j, x] * target_rows[j, x]
        sums[x], squares[x], products[x] = s, q, p
    for x in range(W):
        s = q = p = np.float32(0)
        for i in range(_SIDE):
            s += sums[x + i]
            q += squares[x + i]
            p += products[x + i]
        covariance = p - s * total[x] / _AREA
        spread = max(q + _FLOOR - s * s / _AREA, _FLOOR) * deviation[x]
        differ = np.float32(np.int32(_count_ones(_census(near, x) ^ bits[x])))
        value = zncc_share * (np.float32(1) - covariance / np.sqrt(spread)) + census_share * differ
        value = min(max(value, np.float32(0)), np.float32(200))
        cost[x] = np.uint8(np.int32(value + np.float32(0.5)))


@kernel
def _matching_cost(counter, wide, squares, A, e, inverse_depths, zncc_share, census_share, volume):
    y0 = take(counter) * BLOCK_ROWS
    while y0 < len(volume):
        part = volume[y0 : y0 + BLOCK_ROWS]
        _block_cost(wide, squares, A, e, inverse_depths, zncc_share, census_share, y0, part)
        y0 = take(counter) * BLOCK_ROWS


@kernel
def _block_cost(wide, squares, A, e, inverse_depths, zncc_share, census_share, y0, volume):
    """Compute the costs of the rows of ``volume``, the first of which is row ``y0``."""
    H, W = squares.shape
    rows, _, D = volume.shape
    target_rows = wide[y0 : y0 + rows + 2 * RADIUS]
    total = np.zeros((rows, W), np.float32)
    deviation = np.zeros((rows, W), np.float32)
    bits = np.empty((rows, W), np.uint32)
    for y in range(rows):
        for x in range(W):
            s = q = np.float32(0)
            for j in range(_SIDE):
                for i in range(_SIDE):
                    s += target_rows[y + j, x + i]
                    q += target_rows[y + j, x + i] ** 2
            total[y, x] = s
            deviation[y, x] = max(q + _FLOOR - s * s / _AREA, _FLOOR)
            bits[y, x] = _census(target_rows[y : y + _SIDE], x)
    at = np.empty(W, np.int32)
    du = np.empty(W, np.float32)
    dv = np.empty(W, np.float32)
    near = np.empty_like(target_rows)
    inside = np.empty((rows + 2 * RADIUS, W), np.bool_)
    columns = np.empty((3, W + 2 * RADIUS), np.float32)
    costs = np.empty((D, rows, W), np.uint8)
    for d in range(D):
        for k in range(rows + 2 * RADIUS):
            y = min(max(y0 - RADIUS + k, 0), H - 1)
            row = near[k]
            middle = row[RADIUS : RADIUS + W]
            _warp_row(squares, A, e, inverse_depths[d], y, at, du, dv, middle, inside[k])
            row[:RADIUS] = middle[0]
            row[RADIUS + W :] = middle[W - 1]
        for y in range(rows):
            window = slice(y, y + _SIDE)
            cost = costs[d, y]
            _row_cost(
                near[window], target_rows[window], total[y], deviation[y], bits[y],
                zncc_share, census_share, columns, cost,
            )  # fmt: skip
            visible = inside[y + RADIUS]
            for x in range(W):
                cost[x] = cost[x] if visible[x] else np.uint8(OUTSIDE_COST)
    for y in range(rows):
        for x in range(W):
            for d in range(D):
                volume[y, x, d] = costs[d, y, x]
