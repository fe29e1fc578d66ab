"""Threads that take shares leave none out and take none twice."""

import numba
import numpy as np
import pytest

from slgaussian.kernels.work_sharing import WORKERS, take


@numba.njit(parallel=True)
def _count(shares):
    taken = np.zeros(shares, np.int64)
    counter = np.zeros(1, np.int64)
    for _worker in numba.prange(WORKERS):
        share = take(counter)
        while share < shares:
            taken[share] += 1
            share = take(counter)
    return taken


@pytest.mark.parametrize("shares", [0, 1, 7, 100_000])
def test_every_share_is_taken_once(shares):
    assert (_count(shares) == 1).all()
