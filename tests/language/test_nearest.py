"""The code nearest to a value: what comparing with every code gives, ties included."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.errors import InputError
from slgaussian.language.codes import grid_codes
from slgaussian.language.nearest import nearest_code


def by_comparing_all(values: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """The reference: every value against every code, float64; argmin takes the lowest index."""
    difference = values[..., None, :].astype(np.float64) - codes.astype(np.float64)
    # Summed in the order x, y, z: np.sum may associate differently.
    x, y, z = np.moveaxis(np.abs(difference), -1, 0)
    return (x + y + z).argmin(-1)


@pytest.mark.parametrize("n", [1, 2, 8, 30, 700])
def test_nearest_code_equals_comparing_all_on_every_pixel(n):
    rng = np.random.default_rng(n)
    codes = grid_codes(n, rng)
    values = rng.uniform(-0.2, 1.2, (37, 53, 3)).astype(np.float32)
    found = nearest_code(values, codes)
    assert found.dtype == np.int32
    np.testing.assert_array_equal(found, by_comparing_all(values, codes))


def test_a_value_that_is_not_a_number_is_refused_with_its_place():
    values = np.zeros((4, 5, 3), np.float32)
    values[2, 3, 1] = np.nan
    with pytest.raises(InputError, match=r"\(2, 3\)"):
        nearest_code(values, np.zeros((1, 3), np.float32))
    for bad in (np.nan, np.inf, 1.5):
        with pytest.raises(InputError, match="codes at index 0"):
            nearest_code(values[:1], np.full((1, 3), bad, np.float32))


@pytest.mark.parametrize("codes", [np.zeros((0, 3)), np.zeros((2, 2)), np.zeros((2, 4))])
def test_codes_of_the_wrong_shape_are_refused(codes):
    with pytest.raises(InputError, match="nearest code"):
        nearest_code(np.zeros((2, 3)), codes)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 60), st.sampled_from([4, 16, 0]), st.integers(0, 2**32 - 1))
def test_any_codes_and_values(n, steps, seed):
    """On a coarse grid (``steps``) most values are as near to several codes."""
    rng = np.random.default_rng(seed)
    codes, values = rng.random((n, 3)), rng.uniform(-0.5, 1.5, (300, 3))
    if steps:
        codes, values = np.round(codes * steps) / steps, np.round(values * steps) / steps
    codes, values = codes.astype(np.float32), values.astype(np.float32)
    np.testing.assert_array_equal(nearest_code(values, codes), by_comparing_all(values, codes))


@pytest.mark.parametrize("far", [1.5, 2.5, 1e3])
def test_values_far_outside_the_cube(far):
    rng = np.random.default_rng(0)
    codes = grid_codes(40, rng)
    values = (rng.choice([-1, 0.3, 1], (200, 3)) * far).astype(np.float32)
    np.testing.assert_array_equal(nearest_code(values, codes), by_comparing_all(values, codes))
