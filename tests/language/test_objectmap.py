"""An id map and its objects, against NumPy one object at a time."""

import numpy as np
import pytest

from slgaussian.errors import InputError
from slgaussian.language.locate import central_point
from slgaussian.language.objectmap import ObjectMap


@pytest.mark.parametrize("dtype", [np.uint8, np.int32, np.uint32, np.int64])
@pytest.mark.parametrize("n", [1, 5, 70_000])
def test_values_spread_by_id(n, dtype):
    rng = np.random.default_rng(n)
    top = min(np.iinfo(dtype).max, 2_000_000_000)
    n = min(n, 200) if dtype is np.uint8 else n
    ids = np.sort(rng.choice(np.arange(1, min(top, 10 * n) + 1), n, replace=False)).astype(np.int32)
    ids[-1] = top if top > ids[-1] else ids[-1]  # a sparse one, far beyond any table
    shown = np.append(0, ids)[rng.integers(0, n + 1, (40, 50))].astype(dtype)
    it = ObjectMap(shown, ids)
    np.testing.assert_array_equal(
        it.areas, [(shown == i).sum() for i in ids[:50]] + list(it.areas[50:])
    )
    assert it.areas.sum() == (shown > 0).sum()
    values = rng.random(n).astype(np.float32)
    place = np.searchsorted(ids, shown)
    expected = np.where(shown > 0, values[np.minimum(place, n - 1)], np.float32(-1))
    got = it.spread(values, -1)
    assert got.dtype == np.float32
    np.testing.assert_array_equal(got, expected)
    mask = rng.random(shown.shape) < 0.3
    np.testing.assert_array_equal(
        it.areas_within(mask)[:50], [((shown == i) & mask).sum() for i in ids[:50]]
    )


def test_points_are_those_of_the_objects_and_remembered():
    ids = np.array([2, 7], np.int32)
    shown = np.kron([[2, 0, 7], [2, 7, 7]], np.ones((9, 9))).astype(np.int32)
    it = ObjectMap(shown, ids)
    for place, number in enumerate(ids):
        assert it.point(place) == it.point(place) == central_point(shown == number)


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
def test_a_map_of_other_objects_is_refused(shown, sentence):
    with pytest.raises(InputError, match=sentence):
        ObjectMap(np.array(shown), np.array([2, 7], np.int32))


def test_no_object_at_all():
    it = ObjectMap(np.zeros((3, 4), np.int32), np.zeros(0, np.int32))
    assert it.areas.shape == (0,)
    assert not it.spread(np.zeros(0)).any()
