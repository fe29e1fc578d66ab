"""An id map and its objects, compared with NumPy, one object at a time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import ndimage

from slgaussian.errors import InputError
from slgaussian.language.objectmap import ObjectMap, central_point


@pytest.mark.parametrize("dtype", [np.uint8, np.int32, np.uint32, np.int64])
@pytest.mark.parametrize("n", [1, 5, 70_000])
def test_spread_maps_values_by_id(n, dtype):
    rng = np.random.default_rng(n)
    top = min(np.iinfo(dtype).max, 2_000_000_000)
    n = min(n, 200) if dtype is np.uint8 else n
    ids = np.sort(rng.choice(np.arange(1, min(top, 10 * n) + 1), n, replace=False)).astype(np.int32)
    ids[-1] = top if top > ids[-1] else ids[-1]  # a sparse one, far beyond any table
    labels = np.append(0, ids)[rng.integers(0, n + 1, (40, 50))].astype(dtype)
    it = ObjectMap(labels, ids)
    np.testing.assert_array_equal(
        it.areas, [(labels == i).sum() for i in ids[:50]] + list(it.areas[50:])
    )
    assert it.areas.sum() == (labels > 0).sum()
    values = rng.random(n).astype(np.float32)
    place = np.searchsorted(ids, labels)
    expected = np.where(labels > 0, values[np.minimum(place, n - 1)], np.float32(-1))
    got = it.spread(values, -1)
    assert got.dtype == np.float32
    np.testing.assert_array_equal(got, expected)
    mask = rng.random(labels.shape) < 0.3
    np.testing.assert_array_equal(
        it.areas_within(mask)[:50], [((labels == i) & mask).sum() for i in ids[:50]]
    )


@pytest.mark.parametrize(
    ("shown", "sentence"),
    [
        ([[0, 3]], "object 3 is not in the memory bank"),
        ([[2, 9]], "object 9 is not"),
        ([[2, 1]], "object 1 is not"),
        ([[2, -4]], "negative id -4"),
        ([[2.0, 7.0]], "float64"),
        ([2, 7], r"int64 \(2,\)"),
    ],
)
def test_object_map_raises_input_error_for_unknown_ids(shown, sentence):
    with pytest.raises(InputError, match=sentence):
        ObjectMap(np.array(shown), np.array([2, 7], np.int32))


@given(
    arrays(np.int8, array_shapes(min_dims=2, max_dims=2, max_side=12), elements=st.integers(0, 3)),
    st.integers(0, 2**32 - 1),
)
def test_parts_counts_connected_components(image, seed):
    """Against SciPy's labels of pixels: a pixel touches four others."""
    labels = np.zeros(image.shape, np.int32)
    for value in (1, 2, 3):
        pieces, _ = ndimage.label(image == value)
        labels += np.where(pieces > 0, pieces + labels.max(), 0).astype(np.int32)
    ids = np.arange(1, labels.max() + 3, dtype=np.int32)  # two that the image does not show
    it = ObjectMap(labels, ids)
    selected = np.random.default_rng(seed).random(len(ids)) < 0.6
    assert it.parts(selected) == ndimage.label(it.spread(selected))[1]
    low, high = it.touching.T
    assert (low < high).all() and len(np.unique(it.touching, axis=0)) == len(it.touching)
    separate = ObjectMap(np.array([[1, 0, 1, 2]], np.int32), np.array([1, 2], np.int32))
    assert separate.parts(np.array([True, False])) == 1  # an object in two pieces


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.02, 1), st.floats(0, 4))
def test_central_point_is_farthest_from_the_outside(seed, density, blur):
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
