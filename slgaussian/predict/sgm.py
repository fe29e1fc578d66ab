"""Semi-global matching (Hirschmueller 2008): aggregation along eight paths, and winner selection.

Each half of the paths is aggregated in one sweep over the rows, so that a cost is read twice and
not eight times: memory bandwidth is the limit.
"""

from __future__ import annotations

import numpy as np

from slgaussian.kernels.jit import kernel
from slgaussian.kernels.work_sharing import share, take

_INFINITE_COST = np.int16(20000)


def aggregate(
    cost: np.ndarray,
    guide: np.ndarray,
    p1: int = 20,
    p2: int = 200,
    p2_floor: int = 12,
    contrast: float = 20.0,
) -> np.ndarray:
    """Aggregate matching costs along the paths of semi-global matching.

    Along a path a change of one candidate costs ``p1`` and a larger one
    ``max(p2_floor, p2 / (1 + |dI| / contrast))``, where dI is the gradient of the guide image.
    With ``p1 >= p2`` this is the Potts model: every change costs the same.

    Args:
        cost: uint8 [H, W, D]
        guide: uint8 [H, W]. Grey image.

    Returns:
        uint16 [2, H, W, D]: Sums over the four paths from the left and above, and over their four
            opposites. The sum of both is to be minimised.
    """
    halves = np.empty((2, *cost.shape), np.uint16)
    # Cost of a change by the absolute difference of the guide, 0 to 255.
    jumps = np.maximum(p2_floor, p2 / (1 + np.arange(256) / contrast)).astype(np.int16)
    share(_aggregate, 2, cost, guide, jumps, np.int16(p1), halves)
    return halves


@kernel
def _aggregate(counter, cost, guide, jumps, p1, halves):
    half = take(counter)
    while half < 2:
        _sweep(cost, guide, jumps, p1, half == 0, halves[half])
        half = take(counter)


@kernel
def _sweep(cost, guide, jumps, p1, down, total):
    """Sum the paths along the row, along the column and both diagonals, row after row."""
    H, W, D = cost.shape
    # Padding of one cell at both ends avoids a branch for the first and last candidate.
    start, along = np.empty(D + 2, np.int16), np.empty((2, D + 2), np.int16)
    across = np.empty((2, 3, W, D + 2), np.int16)
    start[:], along[:], across[:] = _INFINITE_COST, _INFINITE_COST, _INFINITE_COST
    start[1 : D + 1] = 0
    least_across = np.zeros((2, 3, W), np.int16)
    for k in range(H):
        y, before = (k, k - 1) if down else (H - 1 - k, H - k)
        new, old = k % 2, (k + 1) % 2
        minimum = np.int16(0)
        for j in range(W):
            x, neighbour = (j, j - 1) if down else (W - 1 - j, W - j)
            pixel_cost, grey, sums = cost[y, x], np.int32(guide[y, x]), total[y, x]
            sums[:] = 0
            this, previous = along[j % 2], along[(j + 1) % 2]
            if j == 0:
                minimum = _follow(start, np.int16(0), jumps[0], p1, pixel_cost, this, sums)
            else:
                jump = jumps[abs(grey - np.int32(guide[y, neighbour]))]
                minimum = _follow(previous, minimum, jump, p1, pixel_cost, this, sums)
            for path in range(3):
                from_x = x + path - 1
                this = across[new, path, x]
                if k == 0 or from_x < 0 or from_x >= W:
                    lowest = _follow(start, np.int16(0), jumps[0], p1, pixel_cost, this, sums)
                else:
                    jump = jumps[abs(grey - np.int32(guide[before, from_x]))]
                    lowest = _follow(
                        across[old, path, from_x], least_across[old, path, from_x], jump, p1,
                        pixel_cost, this, sums,
                    )  # fmt: skip
                least_across[new, path, x] = lowest


@kernel(inline="always")
def _follow(previous, minimum, jump, p1, pixel_cost, this, sums):
    """Extend a path by one pixel: write its costs, add them to ``sums``, return their minimum."""
    ceiling = np.int16(minimum + jump)
    lowest = _INFINITE_COST
    for d in range(pixel_cost.shape[0]):
        side = np.int16(min(previous[d], previous[d + 2]) + p1)
        value = np.int16(min(min(previous[d + 1], side), ceiling) - minimum + pixel_cost[d])
        this[d + 1] = value
        lowest = min(lowest, value)
        sums[d] = np.uint16(sums[d] + np.uint16(value))
    return lowest


@kernel
def select_winners(halves):
    """Select the candidate of minimum cost, with a sub-pixel offset and a margin.

    Args:
        halves: uint16 [2, H, W, D]. From :func:`aggregate`.

    Returns:
        best: int16 [H, W]. Index of the winner; ties go to the lowest candidate.
        offset: float32 [H, W]. From the winner to the minimum of the parabola through it and its
            two neighbours, -0.5 to 0.5; 0 for the first and the last candidate.
        margin: float32 [H, W]. ``1 - minimum / second``, 0 to 1, where second is the minimum cost
            more than one candidate away; 0 where all costs are equal.
    """
    H, W, D = halves.shape[1:]
    best = np.empty((H, W), np.int16)
    offset = np.zeros((H, W), np.float32)
    margin = np.empty((H, W), np.float32)
    for y in range(H):
        costs = np.empty(D, np.int32)
        for x in range(W):
            first_half, second_half = halves[0, y, x], halves[1, y, x]
            minimum = np.int32(2**30)
            for d in range(D):
                costs[d] = np.int32(first_half[d]) + np.int32(second_half[d])
                minimum = min(minimum, costs[d])
            k = 0
            while costs[k] != minimum:
                k += 1
            second = np.int32(2**16)
            for d in range(k - 1):
                second = min(second, costs[d])
            for d in range(k + 2, D):
                second = min(second, costs[d])
            if 0 < k < D - 1:
                left, right = costs[k - 1], costs[k + 1]
                bend = left + right - 2 * minimum
                if bend > 0:
                    offset[y, x] = 0.5 * (left - right) / bend
            best[y, x] = k
            margin[y, x] = 1.0 - minimum / second if second > 0 else 0.0
    return best, offset, margin
