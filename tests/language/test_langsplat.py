"""LangSplat's post-processing against a plain float64 version with SciPy's filters."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from slgaussian.language import langsplat


def filter_plainly(relevancy: np.ndarray, side: int = 30) -> np.ndarray:
    return ndimage.uniform_filter(relevancy.astype(np.float64), side, mode="mirror")


def find_mask_plainly(relevancy: np.ndarray, side: int = 30) -> np.ndarray:
    """Compute the mask step by step, the majority by counting pixels of each window."""
    blend = 0.5 * (filter_plainly(relevancy, side) + relevancy)
    stretched = (blend - blend.min()) / (blend.max() - blend.min() + 1e-9)
    above = np.clip(2 * stretched - 1, 0, 1) > 0.4
    out = np.zeros_like(above)
    voting = above[:-1, :-1]
    for row, column in np.ndindex(*above.shape):
        window = voting[max(row - 3, 0) : row + 4, max(column - 3, 0) : column + 4]
        out[row, column] = 2 * window.sum() > window.size
    return out


def objects_image(seed: int, shape: tuple[int, int]) -> np.ndarray:
    """Relevancies of patches, as a field has them."""
    rng = np.random.default_rng(seed)
    patches = ndimage.zoom(rng.integers(0, 6, (4, 5)), (shape[0] / 4, shape[1] / 5), order=0)
    return rng.random(6)[patches]


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32 - 1), st.integers(1, 90), st.integers(1, 90), st.sampled_from([1, 17, 30])
)
def test_smooth_equals_scipy_uniform_filter(seed, height, width, side):
    """SciPy's filter keeps running sums, with an error of about 1e-15 for each pixel."""
    relevancy = np.random.default_rng(seed).random((height, width))
    got = langsplat.smooth(relevancy, side)
    assert got.shape == relevancy.shape
    np.testing.assert_allclose(got, filter_plainly(relevancy, side), atol=2**-30)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("side", [30, 17])
def test_find_mask_equals_the_reference_steps(seed, side):
    relevancy = objects_image(seed, (60, 85))
    got = langsplat.find_mask(relevancy, side)
    assert got.dtype == bool and 0 < got.mean() < 1
    np.testing.assert_array_equal(got, find_mask_plainly(relevancy, side))
    assert not langsplat.find_mask(np.full((50, 60), 0.7)).any()  # of one value there is none


def test_find_point_takes_the_plateau_pixel_nearest_its_centroid():
    relevancy = np.zeros((200, 260))
    relevancy[60:120, 100:171] = 0.9
    point, peak = langsplat.find_point(relevancy)
    # Full windows fit where all of rows -15 .. +14 and columns alike are inside.
    ys, xs = np.nonzero(peak)
    assert (ys.min(), ys.max(), xs.min(), xs.max()) == (75, 105, 115, 156)
    assert peak.sum() == 31 * 42
    # The centroid's column is 135.5; of the two beside it the first.
    assert point == (135, 90)


def test_smooth_gives_equal_windows_equal_values():
    """Running sums of floats would prefer one of two equal windows by their rounding."""
    rng = np.random.default_rng(0)
    relevancy = np.zeros((120, 400))
    patch = rng.random((40, 40))
    for left in (30, 171, 313):
        relevancy[40:80, left : left + 40] = patch
    smooth = langsplat.smooth(relevancy)
    np.testing.assert_array_equal(smooth[40:80, 30:70], smooth[40:80, 171:211])
    np.testing.assert_array_equal(smooth[40:80, 30:70], smooth[40:80, 313:353])
    assert langsplat.find_point(relevancy)[1].sum() % 3 == 0
