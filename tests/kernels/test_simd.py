"""Vectors in Numba functions against NumPy, lane by lane and to the last bit where that is due."""

import numba
import numpy as np
import pytest

from slgaussian.kernels.simd import (
    LANES,
    vabs,
    vall,
    vany,
    vceil,
    vexp2,
    vfloor,
    vload,
    vlog2,
    vnarrow,
    vsqrt,
    vstore,
    vsum,
    vwhere,
    vwiden,
    vzero,
)

A, B = np.random.default_rng(0).normal(size=(2, LANES)).astype(np.float32)
B[::3] = A[::3]  # so that comparisons also meet equal numbers
SCALAR = np.float32(0.25)


@numba.njit
def _arithmetic(out, a, b):
    x, y = vload(a, 0), vload(b, 0)
    vstore(out, 0, x + y)
    vstore(out, LANES, x - y)
    vstore(out, 2 * LANES, x * y)
    vstore(out, 3 * LANES, x / y)


@numba.njit
def _with_scalars(out, a, s):
    x = vload(a, 0)
    vstore(out, 0, x + s)
    vstore(out, LANES, s + x)
    vstore(out, 2 * LANES, x - s)
    vstore(out, 3 * LANES, s - x)
    vstore(out, 4 * LANES, x * s)
    vstore(out, 5 * LANES, s * x)
    vstore(out, 6 * LANES, x / s)
    vstore(out, 7 * LANES, s / x)


@numba.njit
def _compare(out, a, b, s):
    x, y, one = vload(a, 0), vload(b, 0), np.float32(1)
    vstore(out, 0, vwhere(x < y, one, vzero()))
    vstore(out, LANES, vwhere(x <= y, one, vzero()))
    vstore(out, 2 * LANES, vwhere(x > y, one, vzero()))
    vstore(out, 3 * LANES, vwhere(x >= y, one, vzero()))
    vstore(out, 4 * LANES, vwhere(x < s, one, vzero()))
    vstore(out, 5 * LANES, vwhere(s < x, one, vzero()))


@numba.njit
def _choose(out, a, b, s):
    x, y = vload(a, 0), vload(b, 0)
    vstore(out, 0, vwhere(x < y, x, y))
    vstore(out, LANES, vwhere(x < y, x, s))
    vstore(out, 2 * LANES, vwhere(x < y, s, y))
    vstore(out, 3 * LANES, vwhere((x < y) & (y > s), x, y))


@numba.njit
def _of_one(out, a):
    x = vwiden(vload(a, 0))
    vstore(out, 0, vfloor(x))
    vstore(out, LANES, vceil(x))
    vstore(out, 2 * LANES, vabs(x))
    vstore(out, 3 * LANES, vsqrt(vabs(x)))
    vstore(out, 4 * LANES, -x)
    vstore(out, 5 * LANES, vwiden(vnarrow(x * 0.1)))


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
def _scalar(mask, a, b):
    return vwhere(mask, a, b)


@numba.njit
def _powers(out, a):
    for i in range(0, len(a), LANES):
        vstore(out, i, vexp2(vload(a, i)))


@numba.njit
def _logs(out, a):
    for i in range(0, len(a), LANES):
        vstore(out, i, vlog2(vload(a, i)))


def rows_of(function, count, *arguments, dtype=np.float32):
    """What a function writes: [count, LANES]."""
    out = np.full(count * LANES, 77, dtype)
    function(out, *arguments)
    return out.reshape(count, LANES)


def mapped(function, values, filler=1):
    """A function over any number of values."""
    padded = np.full(-(-len(values) // LANES) * LANES, filler, np.float32)
    padded[: len(values)] = values
    out = np.empty_like(padded)
    function(out, padded)
    return out[: len(values)]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_arithmetic_of_two_vectors(dtype):
    a, b = A.astype(dtype), B.astype(dtype)
    expected = [a + b, a - b, a * b, a / b]
    np.testing.assert_array_equal(rows_of(_arithmetic, 4, a, b, dtype=dtype), expected)


@pytest.mark.parametrize("scalar", [np.float64(1.7), 3, np.int32(-3), np.uint32(3)])
def test_a_scalar_stands_for_a_vector_of_the_other_side(scalar):
    """Float64 and whole numbers are rounded to the float32 of the vector first."""
    s = np.float32(scalar)
    expected = [A + s, s + A, A - s, s - A, A * s, s * A, A / s, s / A]
    np.testing.assert_array_equal(rows_of(_with_scalars, 8, A, scalar), expected)


def test_comparisons_and_choices():
    """Equal numbers, both infinities, and NaN, which compares with nothing."""
    a, b = A.copy(), B.copy()
    a[:5] = np.inf, -np.inf, np.nan, 1, np.nan
    b[:5] = np.inf, 0, 1, np.nan, np.nan
    expected = np.array([a < b, a <= b, a > b, a >= b, a < 0.5, a > 0.5])
    np.testing.assert_array_equal(rows_of(_compare, 6, a, b, 0.5), expected)
    less, s = A < B, SCALAR
    pairs = [(less, A, B), (less, A, s), (less, s, B), (less & (s < B), A, B)]
    expected = [np.where(*pair) for pair in pairs]
    np.testing.assert_array_equal(rows_of(_choose, 4, A, B, s), expected)
    assert (_scalar(True, 1.5, 2), _scalar(False, 1.5, 2)) == (1.5, 2.0)


def test_functions_of_one_number():
    x = (10 * A).astype(np.float64)
    narrow = (x * 0.1).astype(np.float32)
    expected = [np.floor(x), np.ceil(x), abs(x), np.sqrt(abs(x)), -x, narrow]
    np.testing.assert_array_equal(rows_of(_of_one, 6, 10 * A, dtype=np.float64), expected)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_load_and_store_at_any_place(dtype):
    """No alignment is asked for, and nothing beside the numbers is touched."""
    source = np.arange(40, dtype=dtype)
    for start, end in np.ndindex(9, 9):
        target, expected = np.full((2, 24), -1, dtype)
        _move(source, start, target, end)
        expected[end : end + LANES] = source[start : start + LANES]
        np.testing.assert_array_equal(target, expected)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_sum_folds_halves(dtype):
    """Float sums depend on their order, and bytes must not depend on the machine."""
    for seed in range(20):
        a = folded = (np.random.default_rng(seed).normal(size=LANES) * 1e3).astype(dtype)
        while len(folded) > 1:
            folded = folded[: len(folded) // 2] + folded[len(folded) // 2 :]
        assert _sum(a) == folded[0]


def test_any_and_all_see_every_lane():
    eye = np.eye(LANES, dtype=np.float32)
    assert _some_and_all_positive(eye[0] * 0 + 1) == (True, True)
    assert _some_and_all_positive(eye[0] * np.nan) == (False, False)
    for lane in eye:
        assert _some_and_all_positive(lane) == (True, False)
        assert _some_and_all_positive(1 - lane) == (True, False)


def test_exp2():
    rng = np.random.default_rng(0)
    x = np.concatenate([np.linspace(-100, 127, 500_000), rng.uniform(-1, 1, 100_000)])
    true = np.exp2(x.astype(np.float32).astype(np.float64))
    # Measured 2.4e-7, two units in the last place.
    assert (np.abs(mapped(_powers, x) - true) / true).max() < 4e-7
    full = np.arange(-99, 128)
    np.testing.assert_array_equal(mapped(_powers, full), np.exp2(full.astype(float)))
    # No infinity, no NaN, and no subnormals, which are slow; an alpha must not exceed the opacity.
    low = [-100, -100.5, -126, -127, -1e3, -1e30, -np.inf, np.nan]
    np.testing.assert_array_equal(mapped(_powers, low), np.full(8, 2.0**-100))
    assert mapped(_powers, -np.geomspace(1e-38, 1, 10_000)).max() <= 1
    assert mapped(_powers, [0.0, -0.0])[0] == 1


def test_log2():
    rng = np.random.default_rng(1)
    near_one = 1 + rng.uniform(-1, 1, 20_000) * 2.0 ** rng.integers(-24, -1, 20_000)
    anywhere = 2.0 ** rng.uniform(-126, 127, 20_000)
    for x in (near_one, anywhere, [np.nextafter(1, 0, dtype=np.float32), np.sqrt(0.5), 2**-126]):
        true = np.log2(np.asarray(x, np.float32).astype(np.float64))
        # Measured 2.0e-7.
        np.testing.assert_allclose(mapped(_logs, x), true, rtol=3e-7, atol=0)
    full = np.arange(-126, 128)
    np.testing.assert_array_equal(mapped(_logs, 2.0**full), full)
    assert np.isfinite(mapped(_logs, [0, 1e-45, 1e-40])).all()
