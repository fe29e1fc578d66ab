"""Vectors in Numba functions, beyond the arithmetic that tests of the rasterizer cover."""

import numba
import numpy as np
import pytest

from slgaussian.kernels.simd import LANES, vall, vany, vexp2, vload, vlog2, vstore, vsum


@numba.njit
def _move(source, start, target, end):
    vstore(target, end, vload(source, start))


@numba.njit
def _sum(a):
    return vsum(vload(a, 0))


@numba.njit
def _some_and_all_positive(a):
    positive = vload(a, 0) > np.float32(0)
    return vany(positive), vall(positive)


@numba.njit
def _powers(out, a):
    for i in range(0, len(a), LANES):
        vstore(out, i, vexp2(vload(a, i)))


@numba.njit
def _logs(out, a):
    for i in range(0, len(a), LANES):
        vstore(out, i, vlog2(vload(a, i)))


def map_vectors(function, values, filler=1):
    """Apply a vector function to any number of values."""
    padded = np.full(-(-len(values) // LANES) * LANES, filler, np.float32)
    padded[: len(values)] = values
    out = np.empty_like(padded)
    function(out, padded)
    return out[: len(values)]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_vload_and_vstore_need_no_alignment(dtype):
    """Loads and stores need no alignment and change no neighbouring numbers."""
    source = np.arange(40, dtype=dtype)
    for start, end in np.ndindex(9, 9):
        target, expected = np.full((2, 24), -1, dtype)
        _move(source, start, target, end)
        expected[end : end + LANES] = source[start : start + LANES]
        np.testing.assert_array_equal(target, expected)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_vsum_folds_halves(dtype):
    """Float sums depend on their order, and bytes must not depend on the machine."""
    for seed in range(20):
        a = folded = (np.random.default_rng(seed).normal(size=LANES) * 1e3).astype(dtype)
        while len(folded) > 1:
            folded = folded[: len(folded) // 2] + folded[len(folded) // 2 :]
        assert _sum(a) == folded[0]


def test_vany_and_vall_see_every_lane():
    eye = np.eye(LANES, dtype=np.float32)
    assert _some_and_all_positive(eye[0] * 0 + 1) == (True, True)
    assert _some_and_all_positive(eye[0] * np.nan) == (False, False)
    for lane in eye:
        assert _some_and_all_positive(lane) == (True, False)
        assert _some_and_all_positive(1 - lane) == (True, False)


def test_vexp2_equals_float64_within_its_range():
    rng = np.random.default_rng(0)
    x = np.concatenate([np.linspace(-100, 127, 500_000), rng.uniform(-1, 1, 100_000)])
    true = np.exp2(x.astype(np.float32).astype(np.float64))
    # Measured 2.4e-7, two units in the last place.
    assert (np.abs(map_vectors(_powers, x) - true) / true).max() < 4e-7
    full = np.arange(-99, 128)
    np.testing.assert_array_equal(map_vectors(_powers, full), np.exp2(full.astype(float)))
    # No infinity, no NaN, and no subnormals, which are slow; an alpha must not exceed the opacity.
    low = [-100, -100.5, -126, -127, -1e3, -1e30, -np.inf, np.nan]
    np.testing.assert_array_equal(map_vectors(_powers, low), np.full(8, 2.0**-100))
    assert map_vectors(_powers, -np.geomspace(1e-38, 1, 10_000)).max() <= 1
    assert map_vectors(_powers, [0.0, -0.0])[0] == 1


def test_vlog2_equals_float64():
    rng = np.random.default_rng(1)
    near_one = 1 + rng.uniform(-1, 1, 20_000) * 2.0 ** rng.integers(-24, -1, 20_000)
    anywhere = 2.0 ** rng.uniform(-126, 127, 20_000)
    for x in (near_one, anywhere, [np.nextafter(1, 0, dtype=np.float32), np.sqrt(0.5), 2**-126]):
        true = np.log2(np.asarray(x, np.float32).astype(np.float64))
        # Measured 2.0e-7.
        np.testing.assert_allclose(map_vectors(_logs, x), true, rtol=3e-7, atol=0)
    full = np.arange(-126, 128)
    np.testing.assert_array_equal(map_vectors(_logs, 2.0**full), full)
    assert np.isfinite(map_vectors(_logs, [0, 1e-45, 1e-40])).all()
