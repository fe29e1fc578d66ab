"""ID codes: distinct points of the paper's grid, and an exact nearest-code search."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.errors import InputError
from slgaussian.language.codes import grid_codes, nearest_code


def by_comparing_all(values: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """The reference: every value against every code, float64; argmin takes the lowest index."""
    difference = values[..., None, :].astype(np.float64) - codes.astype(np.float64)
    # Summed in the order x, y, z: np.sum may associate differently.
    distance = np.abs(difference[..., 0]) + np.abs(difference[..., 1])
    return (distance + np.abs(difference[..., 2])).argmin(-1)


@pytest.mark.parametrize(
    ("n", "side"), [(2, 2), (8, 2), (9, 3), (27, 3), (28, 4), (1000, 10), (1001, 11), (10_000, 22)]
)
def test_codes_are_distinct_points_of_the_smallest_grid_that_holds_them(n, side):
    codes = grid_codes(n, np.random.default_rng(0))
    assert codes.shape == (n, 3)
    assert codes.dtype == np.float32
    assert len(np.unique(codes, axis=0)) == n
    steps = codes * (side - 1)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-5)
    assert codes.min() >= 0
    assert codes.max() <= 1
    # A smaller cube would not have held them; and past a few objects all levels do occur.
    assert (side - 1) ** 3 < n
    if n == side**3:
        assert all(len(np.unique(codes[:, axis])) == side for axis in range(3))


def test_a_perfect_cube_uses_every_point_of_its_grid():
    codes = grid_codes(27, np.random.default_rng(5))
    points = {tuple(p) for p in (codes * 2).round().astype(int)}
    assert points == {(i, j, k) for i in range(3) for j in range(3) for k in range(3)}


def test_one_object_gets_the_centre():
    np.testing.assert_array_equal(grid_codes(1, np.random.default_rng(0)), [[0.5, 0.5, 0.5]])


def test_codes_depend_on_the_generator_alone():
    first, again, other = (grid_codes(20, np.random.default_rng(s)) for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


@pytest.mark.parametrize("n", [0, -3])
def test_no_objects_are_refused(n):
    with pytest.raises(InputError, match="at least one object"):
        grid_codes(n, np.random.default_rng(0))


@pytest.mark.parametrize("n", [1, 2, 8, 30, 700])
def test_nearest_code_equals_comparing_all_on_every_pixel(n):
    rng = np.random.default_rng(n)
    codes = grid_codes(n, rng)
    values = rng.uniform(-0.2, 1.2, (37, 53, 3)).astype(np.float32)
    found = nearest_code(values, codes)
    assert found.dtype == np.int32
    np.testing.assert_array_equal(found, by_comparing_all(values, codes))


def test_nearest_code_equals_comparing_all_on_ties_and_corners():
    rng = np.random.default_rng(3)
    codes = grid_codes(60, rng)
    halves = np.stack(np.meshgrid(*[np.arange(9) / 8] * 3), -1).astype(np.float32)
    values = np.concatenate([halves.reshape(-1, 3), codes, (codes[:-1] + codes[1:]) / 2])
    np.testing.assert_array_equal(nearest_code(values, codes), by_comparing_all(values, codes))


def test_a_tie_goes_to_the_lowest_index_whatever_the_place():
    corners = np.array([[1, 0, 0], [0, 0, 0], [0, 1, 0], [1, 1, 1]], np.float32)
    middle = np.array([0.5, 0.5, 0], np.float32)  # distance 1 from the first three
    for turn in range(3):
        order = np.roll([0, 1, 2], turn).tolist()
        assert nearest_code(middle, corners[[*order, 3]]) == 0


@pytest.mark.parametrize("corner", [(0, 0, 0), (1, 1, 1), (1, 0, 1)])
def test_a_code_at_a_corner_answers_to_values_at_and_beyond_it(corner):
    codes = np.array([(0.5, 0.5, 0.5), corner], np.float32)
    corner = np.array(corner, np.float32)
    values = np.stack([corner, corner + 0.3 * (2 * corner - 1)])
    np.testing.assert_array_equal(nearest_code(values, codes), [1, 1])


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_every_code_is_nearest_to_itself_even_when_disturbed(n, seed):
    rng = np.random.default_rng(seed)
    codes = grid_codes(n, rng)
    # Codes differ by at least one grid step in some axis, so under half a step is always safe.
    step = 1 / max(np.ceil(np.cbrt(n)) - 1, 1)
    noise = rng.dirichlet([1, 1, 1], n) * 0.49 * step * rng.choice([-1, 1], (n, 3))
    np.testing.assert_array_equal(nearest_code(codes + noise, codes), np.arange(n))


def test_a_value_that_is_not_a_number_is_refused_with_its_place():
    values = np.zeros((4, 5, 3), np.float32)
    values[2, 3, 1] = np.nan
    with pytest.raises(InputError, match=r"\(2, 3\)"):
        nearest_code(values, np.zeros((1, 3), np.float32))
    with pytest.raises(InputError, match="codes at index"):
        nearest_code(values[:1], np.full((1, 3), np.inf, np.float32))


@pytest.mark.parametrize("codes", [np.zeros((0, 3)), np.zeros((2, 2))])
def test_codes_of_the_wrong_shape_are_refused(codes):
    with pytest.raises(InputError, match="nearest code"):
        nearest_code(np.zeros((2, 3)), codes)
