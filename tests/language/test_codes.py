"""ID codes by every strategy: distinct points of the cube, the same for the same seed."""

import numpy as np
import pytest

from slgaussian.errors import InputError
from slgaussian.labels import LabelMaps
from slgaussian.language import CODES, load_codes
from slgaussian.language.codes import grid_codes


@pytest.mark.parametrize(
    ("n", "dimension", "side"),
    [(2, 3, 2), (8, 3, 2), (9, 3, 3), (27, 3, 3), (28, 3, 4), (1000, 3, 10), (1001, 3, 11)]
    + [(10_000, 3, 22), (5, 1, 5), (9, 2, 3), (10, 2, 4), (60, 1, 60)],
)
def test_codes_are_distinct_points_of_the_smallest_grid_that_holds_them(n, dimension, side):
    codes = grid_codes(n, np.random.default_rng(0), dimension)
    assert codes.shape == (n, dimension) and codes.dtype == np.float32
    assert len(np.unique(codes, axis=0)) == n
    steps = codes * (side - 1)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-5)
    assert codes.min() >= 0 and codes.max() <= 1
    # A smaller grid would not have held them; and past a few objects all levels do occur.
    assert (side - 1) ** dimension < n
    if n == side**dimension:
        assert all(len(np.unique(codes[:, axis])) == side for axis in range(dimension))


def test_one_object_gets_the_centre():
    np.testing.assert_array_equal(grid_codes(1, np.random.default_rng(0)), [[0.5, 0.5, 0.5]])


def maps_of(n: int) -> LabelMaps:
    """Two views of ``n`` small squares side by side, ids far apart."""
    side = int(np.ceil(np.sqrt(n)))
    squares = np.arange(side * side).reshape(side, side) * 7 + 3
    squares[squares > 7 * (n - 1) + 3] = 0
    labels = np.kron(squares, np.ones((3, 3), np.int64)).astype(np.int32)
    return LabelMaps(
        np.stack([labels, np.roll(labels, 1, 1)]), np.ones((2, *labels.shape), np.float32)
    )


@pytest.mark.parametrize("name", sorted(CODES))
@pytest.mark.parametrize("n", [1, 2, 3, 27, 28, 10_000])
def test_every_strategy_gives_every_object_a_code_of_its_own(name, n):
    maps = maps_of(n)
    assert len(maps.ids) == n
    codes, again = (load_codes(name)(maps, np.random.default_rng(4)) for _ in range(2))
    assert codes.dtype == np.float32
    assert codes.tobytes() == again.tobytes()
    if name == "exact":
        assert codes.shape == (n, 0)
        return
    assert codes.shape == (n, 3)
    assert len(np.unique(codes, axis=0)) == n
    assert codes.min() >= 0
    assert codes.max() <= 1


@pytest.mark.parametrize("name", sorted(CODES))
def test_label_maps_without_an_object_are_refused(name):
    empty = LabelMaps(np.zeros((1, 4, 4), np.int32), np.zeros((1, 4, 4), np.float32))
    with pytest.raises(InputError, match="no object"):
        load_codes(name)(empty, np.random.default_rng(0))


@pytest.mark.parametrize("name", ["grid", "separated"])
@pytest.mark.parametrize("dimension", [0, 4, -1])
def test_other_dimensions_are_refused(name, dimension):
    with pytest.raises(InputError, match="dimension: found"):
        load_codes(name, dimension=dimension)
