"""Reported times exclude the compilation of kernels."""

import time

import numba
import pytest

from slgaussian.kernels import compiling


def test_clock_excludes_compilation():
    @numba.njit
    def twice(x):
        return 2 * x

    spent, start, ticks = compiling.spent(), time.perf_counter(), compiling.clock()
    twice(1)
    took, counted = time.perf_counter() - start, compiling.clock() - ticks
    compiled = compiling.spent() - spent
    assert 0 < compiled < took and counted == pytest.approx(took - compiled, abs=1e-3)
