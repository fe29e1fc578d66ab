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
    vload_half,
    vlog2,
    vnarrow,
    vsqrt,
    vstore,
    vstore_half,
    vsum,
    vwhere,
    vwiden,
    vzero,
)

rng = np.random.default_rng(0)
A = rng.normal(size=LANES).astype(np.float32)
B = rng.normal(size=LANES).astype(np.float32)
B[::3] = A[::3]  # so that comparisons also meet equal numbers


def lanes(function, *arguments, dtype=np.float32):
    """What an njit ``function(out, *arguments)`` writes with ``vstore(out, 0, ...)``."""
    out = np.full(LANES, 77, dtype)
    function(out, *arguments)
    return out


@numba.njit
def _add(out, a, b):
    vstore(out, 0, vload(a, 0) + vload(b, 0))


@numba.njit
def _subtract(out, a, b):
    vstore(out, 0, vload(a, 0) - vload(b, 0))


@numba.njit
def _multiply(out, a, b):
    vstore(out, 0, vload(a, 0) * vload(b, 0))


@numba.njit
def _divide(out, a, b):
    vstore(out, 0, vload(a, 0) / vload(b, 0))


OPERATIONS = [
    (_add, np.add),
    (_subtract, np.subtract),
    (_multiply, np.multiply),
    (_divide, np.divide),
]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("ours", "numpys"), OPERATIONS, ids=[n.__name__ for _, n in OPERATIONS])
def test_arithmetic_of_two_vectors(ours, numpys, dtype):
    a, b = A.astype(dtype), B.astype(dtype)
    np.testing.assert_array_equal(lanes(ours, a, b, dtype=dtype), numpys(a, b))


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


@pytest.mark.parametrize(
    "scalar", [np.float32(1.7), np.float64(1.7), 3, np.int32(-3), np.uint32(3)]
)
def test_a_scalar_stands_for_a_vector_of_the_other_side(scalar):
    """Float64 and whole numbers are rounded to the float32 of the vector first."""
    out = np.empty(8 * LANES, np.float32)
    _with_scalars(out, A, scalar)
    s = np.float32(scalar)
    expected = [A + s, s + A, A - s, s - A, A * s, s * A, A / s, s / A]
    np.testing.assert_array_equal(out.reshape(8, LANES), expected)


@numba.njit
def _compare(out, a, b, s):
    x, y = vload(a, 0), vload(b, 0)
    for i in range(6):
        if i == 0:
            mask = x < y
        elif i == 1:
            mask = x <= y
        elif i == 2:
            mask = x > y
        elif i == 3:
            mask = x >= y
        elif i == 4:
            mask = x < s
        else:
            mask = s < x
        vstore(out, i * LANES, vwhere(mask, np.float32(1), x * np.float32(0)))


def test_comparisons():
    """Equal numbers, both infinities, and NaN, which compares with nothing."""
    a, b = A.copy(), B.copy()
    a[:5] = np.inf, -np.inf, np.nan, 1, np.nan
    b[:5] = np.inf, 0, 1, np.nan, np.nan
    out = np.empty(6 * LANES, np.float32)
    _compare(out, np.where(np.isfinite(a), a, 0), b, 0.5)  # x * 0 must be 0
    a = np.where(np.isfinite(a), a, np.float32(0))
    expected = np.array([a < b, a <= b, a > b, a >= b, a < 0.5, a > 0.5])
    np.testing.assert_array_equal(out.reshape(6, LANES), expected)


@numba.njit
def _choose(out, a, b, s):
    x, y = vload(a, 0), vload(b, 0)
    vstore(out, 0, vwhere(x < y, x, y))
    vstore(out, LANES, vwhere(x < y, x, s))
    vstore(out, 2 * LANES, vwhere(x < y, s, y))
    vstore(out, 3 * LANES, vwhere((x < y) & (y > s), x, y))


def test_where_and_both():
    out = np.empty(4 * LANES, np.float32)
    _choose(out, A, B, np.float32(0.25))
    less, s = A < B, np.float32(0.25)
    expected = [
        np.where(less, A, B),
        np.where(less, A, s),
        np.where(less, s, B),
        np.where(less & (s < B), A, B),
    ]
    np.testing.assert_array_equal(out.reshape(4, LANES), expected)


@numba.njit
def _move(source, start, target, end):
    vstore(target, end, vload(source, start))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_load_and_store_at_any_place(dtype):
    """No alignment is asked for, and nothing beside the numbers is touched."""
    source = np.arange(40, dtype=dtype)
    for start in range(9):
        for end in range(9):
            target = np.full(24, -1, dtype)
            _move(source, start, target, end)
            expected = np.full(24, -1, dtype)
            expected[end : end + LANES] = source[start : start + LANES]
            np.testing.assert_array_equal(target, expected)


@numba.njit
def _zero(out):
    vstore(out, 0, vzero())


def test_zero():
    np.testing.assert_array_equal(lanes(_zero), np.zeros(LANES))


@numba.njit
def _narrow(out, a):
    vstore_half(out, 0, vload(a, 0))


@numba.njit
def _widen(out, a):
    vstore(out, 0, vload_half(a, 0))


@pytest.mark.parametrize("size", [1.0, 1e-3, 1e-6, 1e-9, 1e4, 1e6])
def test_halves_round_as_numpy_does(size):
    """Below the smallest normal half, and past the largest, too."""
    with np.errstate(over="ignore"):
        expected = (size * A).astype(np.float16)
    bits = lanes(_narrow, (size * A).astype(np.float32), dtype=np.uint16)
    np.testing.assert_array_equal(bits.view(np.float16), expected)
    np.testing.assert_array_equal(lanes(_widen, bits), expected.astype(np.float32))


@numba.njit
def _sum(a):
    return vsum(vload(a, 0))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_sum_folds_halves(dtype):
    """Float sums depend on their order, and bytes must not depend on the machine."""
    for seed in range(20):
        a = (np.random.default_rng(seed).normal(size=LANES) * 1e3).astype(dtype)
        folded = a
        while len(folded) > 1:
            folded = folded[: len(folded) // 2] + folded[len(folded) // 2 :]
        assert _sum(a) == folded[0]


@numba.njit
def _any_positive(a):
    return vany(vload(a, 0) > np.float32(0))


def test_any_sees_every_lane():
    assert not _any_positive(np.zeros(LANES, np.float32))
    assert not _any_positive(np.full(LANES, np.nan, np.float32))
    for lane in range(LANES):
        assert _any_positive(np.eye(LANES, dtype=np.float32)[lane])


@numba.njit
def _powers(out, a):
    for i in range(0, len(a), LANES):
        vstore(out, i, vexp2(vload(a, i)))


def powers(x) -> np.ndarray:
    """2^x of any number of values."""
    padded = np.zeros(-(-len(x) // LANES) * LANES, np.float32)
    padded[: len(x)] = x
    out = np.empty_like(padded)
    _powers(out, padded)
    return out[: len(x)]


def test_exp2():
    x = np.concatenate([np.linspace(-100, 127, 500_000), rng.uniform(-1, 1, 100_000)])
    x = x.astype(np.float32)
    true = np.exp2(x.astype(np.float64))
    # Measured 2.4e-7, two units in the last place.
    assert (np.abs(powers(x) - true) / true).max() < 4e-7


def test_exp2_of_whole_numbers_is_exact():
    x = np.arange(-99, 128)
    np.testing.assert_array_equal(powers(x), np.exp2(x.astype(np.float64)).astype(np.float32))


def test_exp2_never_leaves_what_is_next_to_nothing():
    """Under -100 it stays there: no infinity, no NaN, and no subnormals, which are slow."""
    x = np.array([-100, -100.5, -126, -127, -1e3, -1e30, -np.inf, np.nan], np.float32)
    np.testing.assert_array_equal(powers(x), np.full(8, 2.0**-100, np.float32))


def test_exp2_is_at_most_1_at_and_below_0():
    """An alpha must not exceed the opacity."""
    tiny = -np.geomspace(1e-38, 1, 10_000).astype(np.float32)
    assert powers(tiny).max() <= 1
    assert powers(np.array([0.0, -0.0]))[0] == 1


@numba.njit
def _shape(out, a):
    x = vwiden(vload(a, 0))
    vstore(out, 0, vfloor(x))
    vstore(out, LANES, vceil(x))
    vstore(out, 2 * LANES, vabs(x))
    vstore(out, 3 * LANES, vsqrt(vabs(x)))
    vstore(out, 4 * LANES, -x)
    vstore(out, 5 * LANES, vwiden(vnarrow(x * 0.1)))


def test_functions_of_one_number():
    out, a = np.empty(6 * LANES), 10 * A
    _shape(out, a)
    x = a.astype(np.float64)
    narrow = (x * 0.1).astype(np.float32)
    expected = [np.floor(x), np.ceil(x), abs(x), np.sqrt(abs(x)), -x, narrow]
    np.testing.assert_array_equal(out.reshape(6, LANES), expected)


@numba.njit
def _all_positive(a):
    return vall(vload(a, 0) > np.float32(0))


def test_all():
    assert _all_positive(np.ones(LANES, np.float32))
    for lane in range(LANES):
        for wrong in (0, -1, np.nan):
            assert not _all_positive(
                np.where(np.arange(LANES) == lane, wrong, 1).astype(np.float32)
            )


@numba.njit
def _scalar(mask, a, b):
    return vwhere(mask, a, b)


def test_where_takes_scalars():
    assert _scalar(True, 1.5, 2) == 1.5
    assert _scalar(False, 1.5, 2) == 2.0


@numba.njit
def _logs(out, x):
    for i in range(0, len(x), LANES):
        vstore(out, i, vlog2(vload(x, i)))


def logs(x: np.ndarray) -> np.ndarray:
    padded = np.ones(-(-len(x) // LANES) * LANES, np.float32)
    padded[: len(x)] = x
    out = np.empty_like(padded)
    _logs(out, padded)
    return out[: len(x)]


def test_log2():
    rng = np.random.default_rng(1)
    near_one = 1 + rng.uniform(-1, 1, 20_000) * 2.0 ** rng.integers(-24, -1, 20_000)
    anywhere = 2.0 ** rng.uniform(-126, 127, 20_000)
    for x in (near_one, anywhere, [np.nextafter(1, 0, dtype=np.float32), np.sqrt(0.5), 2**-126]):
        x = np.asarray(x, np.float32)
        true = np.log2(x.astype(np.float64))
        # Measured 2.0e-7.
        np.testing.assert_allclose(logs(x), true, rtol=3e-7, atol=0)
    full = np.arange(-126, 128)
    np.testing.assert_array_equal(logs(2.0**full), full)
    assert np.isfinite(logs(np.float32([0, 1e-45, 1e-40]))).all()
