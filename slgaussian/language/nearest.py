"""Nearest ID code in L1 (paper, section 3.2), by comparison with every code.

A field has a hundred codes or so, and most rendered pixels need no search at all
(:mod:`slgaussian.semantic.decode`), so a table or tree costs more than it saves.
"""

from __future__ import annotations

import numpy as np

from slgaussian.errors import InputError
from slgaussian.kernels.jit import kernel


def nearest_code(values: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """Find the code nearest to each value in L1 distance; ties go to the lowest index.

    Args:
        values: float [..., 3]. Rendered codes. They may lie somewhat outside the cube.
        codes: float [N, 3]. At least one.

    Returns:
        int32 [...]: Indices into ``codes``.

    Raises:
        InputError: If there are no codes, shapes do not fit, or a value is NaN or infinite.
    """
    values, codes = np.asarray(values), np.asarray(codes, np.float64)
    if values.shape[-1:] != (3,) or codes.shape[1:] != (3,) or len(codes) == 0:
        raise InputError(
            f"nearest code: found values {values.shape} and codes {codes.shape}, expected "
            "[..., 3] and [N, 3] with N at least 1"
        )
    bad = ~np.isfinite(values).all(-1)
    if bad.any():
        index = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InputError(f"nearest code: values at index {index} hold NaN or infinity")
    nearest = np.empty(values.shape[:-1], np.int32)
    _find_all(values.reshape(-1, 3).astype(np.float64), codes, nearest.reshape(-1))
    return nearest


@kernel
def find(x, y, z, codes):
    """Find the row of the code nearest to (x, y, z), and its distance, float64."""
    best, row = np.inf, 0
    for candidate in range(len(codes)):
        d = distance(x, y, z, codes, candidate)
        if d < best:
            best, row = d, candidate
    return row, best


@kernel(inline="always")
def distance(x, y, z, codes, row):
    """Compute the L1 distance of a value from a code, summed in the order of the axes."""
    return abs(x - codes[row, 0]) + abs(y - codes[row, 1]) + abs(z - codes[row, 2])


@kernel
def _find_all(values, codes, nearest):
    for i in range(len(values)):
        x, y, z = values[i]
        nearest[i], _ = find(x, y, z, codes)
