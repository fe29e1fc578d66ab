"""The located point against its definition, with SciPy's exact transforms."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from slgaussian.language.locate import central_point


def reference_point(region: np.ndarray) -> tuple[int, int]:
    """The definition of the located point, with SciPy's exact transforms."""
    components, _ = ndimage.label(region)  # 4-connected, numbered in row-major order
    largest = 1 + np.bincount(components.ravel())[1:].argmax()
    depth = ndimage.distance_transform_edt(np.pad(components == largest, 1))[1:-1, 1:-1]
    row, column = np.unravel_index(depth.argmax(), depth.shape)
    return int(column), int(row)


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.02, 1), st.floats(0, 4))
def test_the_located_point_follows_its_definition(seed, density, blur):
    rng = np.random.default_rng(seed)
    noise = ndimage.gaussian_filter(rng.random(rng.integers(1, 60, 2)), blur)
    region = noise <= np.quantile(noise, density)
    assert central_point(region) == reference_point(region)


def test_the_located_point_of_a_region_too_large_for_rounded_distances():
    # 717.5 and 717.501 pixels deep: one number in float32 once squared and rounded.
    disc = np.add.outer((np.arange(1500) - 720) ** 2, (np.arange(1600) - 730) ** 2) < 717**2
    disc |= np.add.outer((np.arange(1500) - 781) ** 2, (np.arange(1600) - 882) ** 2) < 718**2
    assert central_point(disc) == reference_point(disc)
