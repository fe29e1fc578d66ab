"""Nearest ID code in L1 (paper, section 3.2), by a lookup table over code space.

The cube is divided into cells, and each cell lists all codes that are nearest to some point of it,
mostly a single one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slgaussian.errors import InputError
from slgaussian.kernels.jit import kernel

CELLS = 16
"""Cells of the cube along each axis."""

SLACK = 1e-9
"""A code is excluded from a cell if another is nearer by this much everywhere in it: far above the
rounding error of float64 distances, 1e-15, so that the result is exact."""


class Lookup(NamedTuple):
    """The codes and, for each cell, the candidates for the nearest code.

    Attributes:
        codes: float64 [N, 3]
        starts: int32 [CELLS^3 + 1]. Cell c has the candidates
            ``members[starts[c] : starts[c + 1]]``.
        members: int32 [candidates]. Rows of ``codes``, ascending in each cell.
    """

    codes: np.ndarray
    starts: np.ndarray
    members: np.ndarray


def make_lookup(codes: np.ndarray) -> Lookup:
    """Build the table for ``codes`` float [N, 3] in [0, 1], N at least 1.

    Raises:
        InputError: If the shape is wrong, or a value is NaN or outside [0, 1].
    """
    codes = np.asarray(codes, np.float64)
    if codes.ndim != 2 or codes.shape[1] != 3 or len(codes) == 0:
        raise InputError(
            f"nearest code: found codes {codes.shape}, expected [N, 3] with N at least 1"
        )
    bad = ~((codes >= 0) & (codes <= 1)).all(1)
    if bad.any():
        raise InputError(
            f"nearest code: codes at index {int(bad.argmax())} are {codes[bad.argmax()].tolist()}, "
            "expected numbers in [0, 1]"
        )
    edges = np.linspace(0, 1, CELLS + 1)
    away = np.abs(edges[:, None] - codes.T[:, None])  # [3, CELLS + 1, N]
    middle = np.abs((edges[1:] + edges[:-1])[:, None] / 2 - codes.T[:, None])
    counts, members = [], []
    for x in range(CELLS):
        # A code may win in a cell if it may be as near as the one nearest to the centre. Along an
        # axis the difference of their distances is monotonic, so its maximum is at an edge.
        rivals = (middle[0, x] + middle[1, :, None] + middle[2]).argmin(2)
        y, z = np.indices(rivals.shape)
        lead = np.zeros((CELLS, CELLS, len(codes)))
        for axis, cell in enumerate((np.full_like(y, x), y, z)):
            ends = [
                away[axis, end, rivals][..., None] - away[axis, end] for end in (cell, cell + 1)
            ]
            lead += np.maximum(*ends)
        candidates = lead >= -SLACK
        counts.append(candidates.sum(2).ravel())
        members.append(np.nonzero(candidates)[2])
    starts = np.concatenate([[0], np.cumsum(np.concatenate(counts))])
    return Lookup(codes, starts.astype(np.int32), np.concatenate(members).astype(np.int32))


def nearest_code(values: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """Find the code nearest to each value in L1 distance; ties go to the lowest index.

    Args:
        values: float [..., 3]. Rendered codes. They may lie somewhat outside the cube.
        codes: float [N, 3]. In [0, 1].

    Returns:
        int32 [...]: Indices into ``codes``, equal to those of an exhaustive search in float64.

    Raises:
        InputError: If there are no codes, shapes do not fit, a code is outside [0, 1], or a value
            is NaN or infinite.
    """
    lookup, values = make_lookup(codes), np.asarray(values)
    if values.shape[-1:] != (3,):
        raise InputError(f"nearest code: found values {values.shape}, expected [..., 3]")
    bad = ~np.isfinite(values).all(-1)
    if bad.any():
        index = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InputError(f"nearest code: values at index {index} hold NaN or infinity")
    flat = values.reshape(-1, 3).astype(np.float64)
    nearest = np.empty(len(flat), np.int32)
    _find(flat, lookup, nearest)
    return nearest.reshape(values.shape[:-1])


@kernel(inline="always")
def find(x, y, z, codes, starts, members):
    """Find the row of the code nearest to (x, y, z), and its distance, float64.

    The other arguments are the unpacked fields of a :class:`Lookup`: Numba counts references
    whenever it unpacks a tuple.

    Outside the cube an axis adds the same distance to all codes, so the nearest cell is valid.
    """
    # Unsigned, so that Numba omits the handling of negative indices.
    i = np.uint32(min(max(x * CELLS, 0.0), CELLS - 1.0))
    j = np.uint32(min(max(y * CELLS, 0.0), CELLS - 1.0))
    k = np.uint32(min(max(z * CELLS, 0.0), CELLS - 1.0))
    cell = (i * np.uint32(CELLS) + j) * np.uint32(CELLS) + k
    best, row = np.inf, np.uint32(0)
    for m in range(np.uint32(starts[cell]), np.uint32(starts[cell + 1])):
        candidate = np.uint32(members[m])
        d = distance(x, y, z, codes, candidate)
        if d < best:
            best, row = d, candidate
    return row, best


@kernel(inline="always")
def distance(x, y, z, codes, row):
    """Compute the L1 distance of a value from a code, summed in the order of the axes."""
    return abs(x - codes[row, 0]) + abs(y - codes[row, 1]) + abs(z - codes[row, 2])


@kernel
def _find(values, lookup, nearest):
    codes, starts, members = lookup
    for i in range(len(values)):
        x, y, z = values[i]
        nearest[i], _ = find(x, y, z, codes, starts, members)
