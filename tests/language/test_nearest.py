"""The nearest code equals that of a comparison with all codes, including ties."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.errors import InputError
from slgaussian.language.nearest import nearest_code


def test_nearest_code_raises_input_error_for_invalid_arrays():
    values = np.zeros((4, 5, 3), np.float32)
    for bad in (np.zeros((0, 3)), np.zeros((2, 2)), np.zeros((2, 4))):
        with pytest.raises(InputError, match="nearest code"):
            nearest_code(values, bad)
    for bad in (np.nan, -0.1, 1.5):
        with pytest.raises(InputError, match="outside"):
            nearest_code(values, np.full((1, 3), bad))
    values[2, 3, 1] = np.nan
    with pytest.raises(InputError, match=r"\(2, 3\)"):
        nearest_code(values, np.zeros((1, 3), np.float32))


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 60), st.sampled_from([4, 16, 0]), st.integers(0, 2**32 - 1))
def test_nearest_code_equals_brute_force(n, steps, seed):
    """On a coarse grid (``steps``) most values are as near to several codes."""
    rng = np.random.default_rng(seed)
    codes, values = rng.random((n, 3)), rng.uniform(-0.5, 1.5, (20, 15, 3))
    values[::5] *= 100
    if steps:
        codes, values = np.round(codes * steps) / steps, np.round(values * steps) / steps
    codes, values = codes.astype(np.float32), values.astype(np.float32)
    difference = np.abs(values[..., None, :].astype(np.float64) - codes.astype(np.float64))
    x, y, z = np.moveaxis(difference, -1, 0)  # summed in this order
    nearest = nearest_code(values, codes)
    assert nearest.dtype == np.int32
    np.testing.assert_array_equal(nearest, (x + y + z).argmin(-1))
