"""For each Gaussian the few near it that are most like it."""

from __future__ import annotations

import numpy as np

from slgaussian.kernels.jit import kernel
from slgaussian.kernels.work_sharing import share, take

CELL = 2.0
"""Least side of a cell, in standard deviations of what is in it; it is below twice that."""

SHARE = 256
"""Gaussians that a thread takes at a time."""


@kernel
def _row(level, y, z):
    """The bucket of the cells y, z of a level at x = 0; those at x follow, so that they adjoin."""
    mixed = np.uint64(level) * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ np.uint64(y)) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ np.uint64(z) ^ (mixed >> np.uint64(31))) * np.uint64(0x94D049BB133111EB)
    return np.int64(mixed >> np.uint64(24))


def likest(
    asked: np.ndarray,
    means: np.ndarray,
    widest: np.ndarray,
    values: np.ndarray,
    most: int,
    far: np.float32,
    unlike: np.float32,
) -> tuple[np.ndarray, np.ndarray]:
    """For each Gaussian that is asked for, up to ``most`` others, the most alike first.

    Two are looked at if they lie in the same or adjoining cells of a grid that suits the width of
    both, are within ``far`` widths of the narrower, and their values within ``unlike``. The more
    alike, the less ``difference / unlike + 4 (distance / far)^2``.

    Parameters
    ----------
    asked : int64 [M]
    means : float32 [N, 3]
    widest : float32 [N]
        Standard deviations.
    values : float32 [N, C]
        Which differ by as much as any of them does.

    Returns
    -------
    int32 [M, most]
        -1 where there are no more.
    float64 [M, most]
        How little alike.
    """
    cells, starts, members, places = _grid(means, widest)
    found = np.full((len(asked), most), -1, np.int32)
    costs = np.full((len(asked), most), np.inf)
    share(
        _look, -(-len(asked) // SHARE), asked, means, widest, values, far, unlike, cells, starts,
        members, places, found, costs,
    )  # fmt: skip
    return found, costs


@kernel
def _grid(means, widest):
    """Cells and levels of all, where each bucket begins, its members, and their places."""
    n, buckets = len(means), 4
    while buckets < 2 * n:
        buckets *= 2
    mask = buckets - 1
    cells = np.empty((n, 4), np.int64)
    own = np.empty(n, np.int64)
    for i in range(n):
        level = np.ceil(np.log2(max(CELL * widest[i], 1e-30)))
        for k in range(3):
            cell = np.floor(means[i, k] * 2.0**-level)
            cells[i, k] = np.int64(min(max(cell, -1e18), 1e18))
        cells[i, 3] = np.int64(level)
        own[i] = (_row(cells[i, 3], cells[i, 1], cells[i, 2]) + cells[i, 0]) & mask
    starts = np.zeros(buckets + 1, np.int64)
    for i in range(n):
        starts[own[i] + 1] += 1
    for b in range(buckets):
        starts[b + 1] += starts[b]
    cursors = starts[:-1].copy()
    members = np.empty(n, np.int32)
    places = np.empty((n, 4), np.float32)
    for i in range(n):
        at = cursors[own[i]]
        cursors[own[i]] += 1
        members[at] = i
        for k in range(3):
            places[at, k] = means[i, k]
        places[at, 3] = widest[i]
    return cells, starts, members, places


@kernel
def _look(
    counter, asked, means, widest, values, far, unlike, cells, starts, members, places, found, costs
):
    start = take(counter) * SHARE
    while start < len(asked):
        for a in range(start, min(len(asked), start + SHARE)):
            _look_for(a, asked[a], means, widest, values, far, unlike, cells, starts, members,
                      places, found, costs)  # fmt: skip
        start = take(counter) * SHARE


@kernel
def _look_for(
    a, i, means, widest, values, far, unlike, cells, starts, members, places, found, costs
):
    mask, channels, most = len(starts) - 2, values.shape[1], found.shape[1]
    x, y, z, wide = means[i, 0], means[i, 1], means[i, 2], widest[i]
    for row in range(9):
        first = _row(cells[i, 3], cells[i, 1] + row // 3 - 1, cells[i, 2] + row % 3 - 1)
        first += cells[i, 0] - 1
        for step in range(3):
            b = (first + step) & mask
            for at in range(starts[b], starts[b + 1]):
                dx, dy, dz = places[at, 0] - x, places[at, 1] - y, places[at, 2] - z
                narrow = max(min(wide, places[at, 3]), np.float32(1e-30)) * far
                cost = np.float64(dx * dx + dy * dy + dz * dz) / (narrow * narrow)
                j = members[at]
                if cost > 1 or 4 * cost >= costs[a, most - 1] or j == i:
                    continue
                if cells[j, 3] != cells[i, 3]:
                    continue
                apart = np.float32(0)
                for c in range(channels):
                    apart = max(apart, abs(values[i, c] - values[j, c]))
                if apart < unlike:
                    _insert(a, j, 4 * cost + apart / unlike, found, costs)


@kernel
def _insert(a, j, cost, found, costs):
    most = found.shape[1]
    for k in range(most):
        if found[a, k] == j:  # cells may share a bucket
            return
    if cost >= costs[a, most - 1]:
        return
    place = most - 1
    while place > 0 and costs[a, place - 1] > cost:
        costs[a, place], found[a, place] = costs[a, place - 1], found[a, place - 1]
        place -= 1
    costs[a, place], found[a, place] = cost, j
