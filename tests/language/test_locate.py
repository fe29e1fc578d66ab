"""The located point against its definition, with SciPy's exact transforms."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from slgaussian.language.locate import central_point


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.02, 1), st.floats(0, 4))
def test_the_located_point_follows_its_definition(seed, density, blur):
    rng = np.random.default_rng(seed)
    noise = ndimage.gaussian_filter(rng.random(rng.integers(1, 60, 2)), blur)
    region = noise <= np.quantile(noise, density)
    column, row = central_point(region)
    components, _ = ndimage.label(region)  # 4-connected
    areas = np.bincount(components.ravel())
    assert region[row, column] and areas[components[row, column]] == areas[1:].max()
    part = np.pad(components == components[row, column], 1)
    depth = ndimage.distance_transform_edt(part)[1:-1, 1:-1]
    assert depth[row, column] >= depth.max() * (1 - 1e-6)
