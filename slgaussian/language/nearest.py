"""Nearest ID code in L1 (paper, section 3.2), by a lookup table over code space.

The cube is divided into cells, and each cell lists all codes that are nearest to some point of it,
mostly a single one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slgaussian.errors import InputError
from slgaussian.kernels.jit import kernel
from slgaussian.kernels.work_sharing import share, take
from slgaussian.language.configs import MOST_DIMENSIONS

LEVELS = {1: 12, 2: 7, 3: 5}
"""Number of bisections of the cube along every axis, by dimension: 4,096 to 32,768 cells, which fit
in a core's cache. More cells were no faster."""

SLACK = 1e-9
"""A code is excluded from a cell if another is nearer by this much everywhere in it: far above the
rounding error of float64 distances, 1e-15, so that the result is exact."""

BEYOND = 1.0
"""Distance from the cube up to which the table is used. Farther out distances lose precision, and
all codes are compared."""

SHARE = 4096
"""Number of values per unit of work of a thread."""


class Lookup(NamedTuple):
    """The codes and, for each cell, the candidates for the nearest code.

    Attributes:
        codes: float64 [N, 3]. Padded with zeros to three dimensions.
        cells: three of int. Number of cells along each axis.
        starts: int32 [cells + 1]. Cell c has the candidates ``members[starts[c] : starts[c + 1]]``.
        members: int32 [candidates]. Rows of ``codes``, ascending in each cell.
    """

    codes: np.ndarray
    cells: tuple[int, int, int]
    starts: np.ndarray
    members: np.ndarray


def make_lookup(codes: np.ndarray) -> Lookup:
    """Build the table for ``codes`` float [N, D] in [0, 1]^D, D from 1 to 3, N at least 1.

    Raises:
        InputError: If the shape is wrong, or a value is NaN or outside [0, 1].
    """
    codes = np.asarray(codes)
    if codes.ndim != 2 or not 1 <= codes.shape[1] <= MOST_DIMENSIONS or len(codes) == 0:
        raise InputError(
            f"nearest code: found codes {codes.shape}, expected [N, D] with N at least 1 and D "
            f"from 1 to {MOST_DIMENSIONS}"
        )
    bad = ~((codes >= 0) & (codes <= 1)).all(1)
    if bad.any():
        raise InputError(
            f"nearest code: codes at index {int(bad.argmax())} are {codes[bad.argmax()].tolist()}, "
            "expected numbers in [0, 1]"
        )
    n, dimension = codes.shape
    padded = np.zeros((n, MOST_DIMENSIONS))
    padded[:, :dimension] = codes
    axes = np.arange(MOST_DIMENSIONS) < dimension
    cells = np.ones(MOST_DIMENSIONS, np.int64)
    starts, members = np.array([0, n], np.int32), np.arange(n, dtype=np.int32)
    for _ in range(LEVELS[dimension]):
        cells = np.where(axes, 2 * cells, 1)
        none = np.empty(0, np.int32)
        counts = _divide(padded, cells, axes, starts, members, none, none)
        divided = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        candidates = np.empty(divided[-1], np.int32)
        _divide(padded, cells, axes, starts, members, divided, candidates)
        starts, members = divided, candidates
    x, y, z = cells.tolist()
    return Lookup(padded, (x, y, z), starts, members)


def nearest_code(values: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """Find the code nearest to each value in L1 distance; ties go to the lowest index.

    Args:
        values: float [..., D]. Rendered codes. They may lie outside the cube.
        codes: float [N, D]. In [0, 1], D from 1 to 3.

    Returns:
        int32 [...]: Indices into ``codes``, equal to those of an exhaustive search in float64.

    Raises:
        InputError: If there are no codes, shapes do not fit, a code is outside [0, 1], or a value
            is NaN or infinite.
    """
    values, codes = np.asarray(values), np.asarray(codes)
    lookup = make_lookup(codes)
    if values.shape[-1:] != codes.shape[1:]:
        raise InputError(
            f"nearest code: found values {values.shape} and codes {codes.shape}, expected "
            f"[..., {codes.shape[1]}]"
        )
    bad = ~np.isfinite(values).all(-1)
    if bad.any():
        index = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InputError(f"nearest code: values at index {index} hold NaN or infinity")
    flat = np.zeros((bad.size, MOST_DIMENSIONS))
    flat[:, : codes.shape[1]] = values.reshape(-1, codes.shape[1])
    nearest = np.empty(len(flat), np.int32)
    share(_find, -(-len(flat) // SHARE), flat, lookup, nearest)
    return nearest.reshape(values.shape[:-1])


@kernel
def _divide(codes, cells, axes, starts, members, divided, candidates):
    """Distribute the candidates of each cell to its halves.

    Returns the number of candidates per new cell, int64. Unless ``divided`` (the new ``starts``) is
    empty, also writes them to ``candidates``.
    """
    counts = np.zeros(cells[0] * cells[1] * cells[2], np.int64)
    low, high, place = np.zeros(3), np.zeros(3), np.empty(3, np.int64)
    for x in range(cells[0]):
        for y in range(cells[1]):
            for z in range(cells[2]):
                cell = (x * cells[1] + y) * cells[2] + z
                place[0], place[1], place[2] = x, y, z
                parent = 0
                for k in range(3):
                    if axes[k]:
                        low[k], high[k] = place[k] / cells[k], (place[k] + 1) / cells[k]
                        parent = parent * (cells[k] // 2) + place[k] // 2
                first, last = starts[parent], starts[parent + 1]
                best, middle = np.inf, 0
                for m in range(first, last):
                    code = codes[members[m]]
                    d = 0.0
                    for k in range(3):
                        d += abs((low[k] + high[k]) / 2 - code[k])
                    if d < best:
                        best, middle = d, members[m]
                for m in range(first, last):
                    if _may_win(codes[members[m]], codes[middle], low, high):
                        if len(divided):
                            candidates[divided[cell] + counts[cell]] = members[m]
                        counts[cell] += 1
    return counts


@kernel
def _may_win(code, rival, low, high):
    """Test whether ``code`` may be as near as ``rival`` to a point between ``low`` and ``high``.

    Along an axis ``|x - rival| - |x - code|`` is monotonic, so its maximum is at an end.
    """
    lead = 0.0
    for k in range(3):
        at_low = abs(low[k] - rival[k]) - abs(low[k] - code[k])
        at_high = abs(high[k] - rival[k]) - abs(high[k] - code[k])
        lead += max(at_low, at_high)
    return lead >= -SLACK


@kernel(inline="always")
def find(x, y, z, codes, across, down, deep, starts, members):
    """Find the row of the code nearest to (x, y, z), and its distance, float64.

    Unused coordinates are 0. The other arguments are the unpacked fields of a :class:`Lookup`:
    Numba counts references whenever it unpacks a tuple.

    Outside the cube an axis adds the same distance to all codes, so the nearest cell is valid.
    """
    best, row = np.inf, np.uint32(0)
    if max(abs(x - 0.5), abs(y - 0.5), abs(z - 0.5)) <= 0.5 + BEYOND:
        # Unsigned, so that Numba omits the handling of negative indices.
        i = np.uint32(min(max(x * across, 0.0), across - 1.0))
        j = np.uint32(min(max(y * down, 0.0), down - 1.0))
        k = np.uint32(min(max(z * deep, 0.0), deep - 1.0))
        cell = (i * np.uint32(down) + j) * np.uint32(deep) + k
        for m in range(np.uint32(starts[cell]), np.uint32(starts[cell + 1])):
            candidate = np.uint32(members[m])
            d = distance(x, y, z, codes, candidate)
            if d < best:
                best, row = d, candidate
    else:
        for m in range(np.uint32(len(codes))):
            d = distance(x, y, z, codes, m)
            if d < best:
                best, row = d, np.uint32(m)
    return row, best


@kernel(inline="always")
def distance(x, y, z, codes, row):
    """Compute the L1 distance of a value from a code, summed in the order of the axes."""
    return abs(x - codes[row, 0]) + abs(y - codes[row, 1]) + abs(z - codes[row, 2])


@kernel
def _find(counter, values, lookup, nearest):
    codes, (across, down, deep), starts, members = lookup
    start = take(counter) * SHARE
    while start < len(values):
        for i in range(start, min(len(values), start + SHARE)):
            x, y, z = values[i]
            nearest[i], _ = find(x, y, z, codes, across, down, deep, starts, members)
        start = take(counter) * SHARE
