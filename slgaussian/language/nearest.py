"""Nearest ID code in L1 (paper, section 3.2), by a table over code space.

The cube is divided into cells, and each cell lists the codes that may be nearest to a point of it.
"""

from __future__ import annotations

import numpy as np

from slgaussian.errors import InputError
from slgaussian.kernels.jit import kernel

CELLS = 16
"""Cells of the cube along each axis."""

SLACK = 1e-9
"""Far above the rounding error of distances, 1e-15, so that the result is that of comparing all."""


def make_table(codes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """List the candidates of each cell for ``codes`` float64 [N, 3] in [0, 1], N at least 1.

    Returns:
        starts: int32 [CELLS^3 + 1]. Cell c has ``members[starts[c] : starts[c + 1]]``.
        members: int32 [candidates]. Rows of ``codes``, ascending in each cell.
    """
    middles = (np.arange(CELLS) + 0.5) / CELLS
    x, y, z = np.abs(middles[:, None] - codes.T[:, None])
    distances = (x[:, None, None] + y[:, None] + z).reshape(CELLS**3, -1)
    # A point of a cell is at most 3 / 2 of a cell from the middle, and distances differ by no more.
    cells, members = np.nonzero(distances <= distances.min(1, keepdims=True) + 3 / CELLS + SLACK)
    starts = np.searchsorted(cells, np.arange(CELLS**3 + 1))
    return starts.astype(np.int32), members.astype(np.int32)


def nearest_code(values: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """Find the code nearest to each value in L1 distance; ties go to the lowest index.

    Args:
        values: float [..., 3]. Rendered codes. They may lie somewhat outside the cube.
        codes: float [N, 3]. In [0, 1], at least one.

    Returns:
        int32 [...]: Indices into ``codes``.

    Raises:
        InputError: If there are no codes, shapes do not fit, a code is outside [0, 1], or a value
            is NaN or infinite.
    """
    values, codes = np.asarray(values), np.asarray(codes, np.float64)
    if values.shape[-1:] != (3,) or codes.shape[1:] != (3,) or len(codes) == 0:
        raise InputError(
            f"nearest code: found values {values.shape} and codes {codes.shape}, expected "
            "[..., 3] and [N, 3] with N at least 1"
        )
    if not ((codes >= 0) & (codes <= 1)).all():
        raise InputError("nearest code: codes hold numbers outside [0, 1]")
    bad = ~np.isfinite(values).all(-1)
    if bad.any():
        index = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InputError(f"nearest code: values at index {index} hold NaN or infinity")
    nearest = np.empty(values.shape[:-1], np.int32)
    flat = values.reshape(-1, 3).astype(np.float64)
    _find_all(flat, codes, *make_table(codes), nearest.reshape(-1))
    return nearest


@kernel(inline="always")
def find(x, y, z, codes, starts, members):
    """Find the row of the code nearest to (x, y, z), and its distance, float64.

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
def _find_all(values, codes, starts, members, nearest):
    for i in range(len(values)):
        x, y, z = values[i]
        nearest[i], _ = find(x, y, z, codes, starts, members)
