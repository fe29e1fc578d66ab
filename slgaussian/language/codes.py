"""ID codes: a low-dimensional vector for every object, and back from a vector to the object.

Section 3.2 of the paper: [0, 1]^3 is divided into ceil(cbrt N)^3 evenly spaced vectors and N of
them are chosen at random; a rendered vector means the object whose code is nearest in L1.
"""

from __future__ import annotations

import numba
import numpy as np

from slgaussian.errors import InputError


def grid_codes(n: int, rng: np.random.Generator) -> np.ndarray:
    """Choose ``n`` distinct codes at random from the paper's even grid.

    Parameters
    ----------
    n : int
        Number of objects, at least 1.
    rng : numpy Generator
        Decides which grid points are used, and in which order.

    Returns
    -------
    float32 [n, 3]
        Points of a k x k x k grid that spans [0, 1]^3 with its corners, k the smallest integer with
        k^3 >= n. A single object, for which such a grid is one point, gets the centre of the cube.

    Raises
    ------
    InputError
        If ``n`` is less than 1.
    """
    if n < 1:
        raise InputError(f"ID codes: asked for {n}, expected at least one object")
    k = _ceil_cbrt(n)
    levels = np.linspace(0, 1, k, dtype=np.float32) if k > 1 else np.array([0.5], np.float32)
    chosen = rng.choice(k**3, n, replace=False)
    return np.stack([levels[axis] for axis in np.unravel_index(chosen, (k, k, k))], 1)


def nearest_code(values: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """Index of the code nearest to each value in L1 distance; ties go to the lowest index.

    Parameters
    ----------
    values : float [..., 3]
        Rendered codes. They may lie outside the cube.
    codes : float [N, 3]

    Returns
    -------
    int32 [...]
        Indices into ``codes``, what comparing with every code in float64 would give.

    Raises
    ------
    InputError
        If there are no codes, the last axis is not 3, or a number is NaN or infinite: a value that
        is not a number is near no code.
    """
    values, codes = np.asarray(values), np.asarray(codes)
    if values.shape[-1:] != (3,) or codes.ndim != 2 or codes.shape[1] != 3 or len(codes) == 0:
        raise InputError(
            f"nearest code: found values {values.shape} and codes {codes.shape}, expected [..., 3] "
            "and [N, 3] with N at least 1"
        )
    for name, array in (("values", values), ("codes", codes)):
        bad = ~np.isfinite(array).all(-1)
        if bad.any():
            where = tuple(int(i) for i in np.argwhere(bad)[0])
            raise InputError(f"nearest code: {name} at index {where} hold NaN or infinity")
    order = np.argsort(codes[:, 0], kind="stable")
    flat = np.ascontiguousarray(values.reshape(-1, 3), np.float64)
    found = np.empty(len(flat), np.int32)
    _search(flat, codes[order].astype(np.float64), order, found)
    return found.reshape(values.shape[:-1])


def _ceil_cbrt(n: int) -> int:
    """Smallest integer k with k^3 >= n; the rounded float root alone is wrong near cubes."""
    k = round(n ** (1 / 3))
    while k**3 < n:
        k += 1
    while (k - 1) ** 3 >= n:
        k -= 1
    return k


@numba.njit(cache=True, parallel=True)
def _search(values: np.ndarray, codes: np.ndarray, order: np.ndarray, found: np.ndarray) -> None:
    """Walk outwards along the first axis, in which ``codes`` are sorted, until it alone is too far.

    A rounded sum of absolute differences is never below one of its terms, so stopping is exact.
    """
    n = len(codes)
    for i in numba.prange(len(values)):
        x, y, z = values[i]
        start = np.searchsorted(codes[:, 0], x)
        best, index = np.inf, n
        for step in (-1, 1):
            j = start - 1 if step < 0 else start
            while 0 <= j < n and abs(codes[j, 0] - x) <= best:
                distance = abs(codes[j, 0] - x) + abs(codes[j, 1] - y) + abs(codes[j, 2] - z)
                if distance < best or (distance == best and order[j] < index):
                    best, index = distance, order[j]
                j += step
        found[i] = index
