"""Semi-global matching (Hirschmueller 2008): costs summed along eight paths, and winners."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

DIRECTIONS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1))
"""Steps (dy, dx) of the eight paths."""

_FAR = np.int16(20000)


def aggregate(
    cost: np.ndarray,
    guide: np.ndarray,
    p1: int = 20,
    p2: int = 200,
    p2_floor: int = 12,
    contrast: float = 20.0,
) -> np.ndarray:
    """Sum of the eight path costs of semi-global matching.

    Along a path a change of one candidate costs ``p1`` and a larger one
    ``max(p2_floor, p2 / (1 + |dI| / contrast))``, where dI is the step of the guide image. With
    ``p1 >= p2`` this is the Potts model: every change costs the same.

    Parameters
    ----------
    cost : uint8 [H, W, D]
    guide : float32 [H, W]
        Grey image, 0 to 255.

    Returns
    -------
    uint16 [H, W, D]
    """
    H, W, D = cost.shape
    total = np.zeros((H, W, D), np.uint16)
    for dy, dx in DIRECTIONS:
        first_row = [(0 if dy > 0 else H - 1, x) for x in range(W)] if dy else []
        first_column = [(y, 0 if dx > 0 else W - 1) for y in range(H)] if dx else []
        starts = np.array(sorted({*first_row, *first_column}), np.int64)
        _aggregate_along(cost, guide, starts, dy, dx, p1, p2, p2_floor, contrast, total)
    return total


@njit(cache=True, parallel=True)
def _aggregate_along(cost, guide, starts, dy, dx, p1, p2, p2_floor, contrast, total):
    """Add the path costs of one direction; lines of a direction never share a pixel."""
    H, W, D = cost.shape
    small = np.int16(p1)
    for line in prange(starts.shape[0]):
        y, x = starts[line]
        # One cell of padding at both ends saves the test for the first and last candidate.
        previous = np.full(D + 2, _FAR, np.int16)
        current = np.full(D + 2, _FAR, np.int16)
        lowest = np.int16(0)
        for d in range(D):
            previous[d + 1] = 0
        while 0 <= y < H and 0 <= x < W:
            py, px = y - dy, x - dx
            step = 0.0
            if 0 <= py < H and 0 <= px < W:
                step = abs(guide[y, x] - guide[py, px])
            jump = np.int16(max(p2_floor, p2 / (1.0 + step / contrast)))
            ceiling = np.int16(lowest + jump)
            here = cost[y, x]
            for d in range(D):
                best = min(previous[d + 1], ceiling)
                side = min(previous[d], previous[d + 2])
                best = min(best, np.int16(side + small))
                current[d + 1] = np.int16(np.int16(best - lowest) + np.int16(here[d]))
            lowest = _FAR
            sums = total[y, x]
            for d in range(D):
                lowest = min(lowest, current[d + 1])
                sums[d] = np.uint16(sums[d] + np.uint16(current[d + 1]))
            previous, current = current, previous
            y += dy
            x += dx


@njit(cache=True, parallel=True)
def winners(total):
    """Candidate of least cost with a sub-pixel offset, and how clearly it won.

    Parameters
    ----------
    total : uint16 [H, W, D]

    Returns
    -------
    index : float32 [H, W]
        Position of the minimum of the parabola through the winner and its two neighbours; ties go
        to the lowest candidate.
    margin : float32 [H, W]
        ``1 - best / second``, 0 to 1, where second is the least cost more than one candidate away;
        0 where all cost the same.
    """
    H, W, D = total.shape
    index = np.empty((H, W), np.float32)
    margin = np.empty((H, W), np.float32)
    for y in prange(H):
        for x in range(W):
            costs = total[y, x]
            best = 0
            for d in range(1, D):
                if costs[d] < costs[best]:
                    best = d
            second = np.int64(65535)
            for d in range(D):
                if costs[d] < second and abs(d - best) > 1:
                    second = np.int64(costs[d])
            least = np.int64(costs[best])
            offset = 0.0
            if 0 < best < D - 1:
                left, right = np.int64(costs[best - 1]), np.int64(costs[best + 1])
                bend = left + right - 2 * least
                if bend > 0:
                    offset = 0.5 * (left - right) / bend
            index[y, x] = best + offset
            margin[y, x] = 1.0 - least / second if second > 0 else 0.0
    return index, margin
