"""Codes whose mixtures at borders read as one of the two objects."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.errors import InputError
from slgaussian.labels import LabelMaps
from slgaussian.language.codes import Separated, grid_codes
from slgaussian.language.nearest import nearest_code
from slgaussian.language.separated import (
    HEAT,
    Pairs,
    _anneal,
    _layout,
    _points,
    misread,
    neighbours,
    place,
)

# Written out, not imported: a slip in the module must show here.
GAPS = (1, 2, 4, 8, 16)


def maps_of(labels: np.ndarray) -> LabelMaps:
    labels = np.asarray(labels, np.int32)
    labels = labels if labels.ndim == 3 else labels[None]
    return LabelMaps(labels, np.ones(labels.shape, np.float32))


def cells(n: int, seed: int) -> LabelMaps:
    """Two views of a picture cut into ``n`` cells around random points."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform(0, 80, (n, 2))
    rows, columns = np.indices((80, 80))
    far = np.hypot(rows[..., None] - centres[:, 0], columns[..., None] - centres[:, 1])
    labels = far.argmin(-1) + 1
    return maps_of(np.stack([labels, np.roll(labels, 2, 1)]))


@settings(max_examples=100, deadline=None)
@given(st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_a_third_code_is_read_if_and_only_if_it_is_in_the_ball(dimension, seed):
    """What the placement rests on, tried with 200 mixtures of two codes."""
    rng = np.random.default_rng(seed)
    a, b, c = codes = rng.random((3, dimension))
    far, radius = np.abs((a + b) / 2 - c).sum(), np.abs(a - b).sum() / 2
    if abs(far - radius) < 1e-3:
        return
    shares = np.linspace(0, 1, 401)[:, None]
    third = (nearest_code((1 - shares) * a + shares * b, codes) == 2).any()
    assert third == (far < radius)


def test_neighbours_are_counted_near_and_through_what_is_not_labelled():
    labels = np.zeros((3, 9), np.int64)
    labels[:, 0:2], labels[:, 2:4], labels[:, 6:9] = 5, 8, 11
    pairs = neighbours(maps_of(labels))
    assert pairs.rows.tolist() == [[0, 1], [0, 2], [1, 2]]
    by_hand = np.zeros(3)
    for gap in GAPS:
        for u in range(9 - gap):
            seen = {labels[0, u], labels[0, u + gap]}
            for k, pair in enumerate(({5, 8}, {5, 11}, {8, 11})):
                by_hand[k] += (seen == pair) / gap**2
    np.testing.assert_allclose(pairs.weights, by_hand / by_hand.sum())


@settings(max_examples=20, deadline=None)
@given(st.integers(2, 25), st.integers(0, 2**32 - 1))
def test_the_names_of_objects_do_not_matter(n, seed):
    maps = cells(n, seed)
    names = np.cumsum(np.random.default_rng(seed).integers(1, 10**7, n)).astype(np.int64)
    renamed = maps_of(names[maps.labels - 1]) if len(maps.ids) == n else maps
    codes = [Separated()(m, np.random.default_rng(1)) for m in (maps, renamed)]
    np.testing.assert_array_equal(*codes)


@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("n", [20])
def test_fewer_mixtures_read_as_a_third_object_than_with_the_grid(n, dimension):
    """Measured: at most 0.58 of it, that in one dimension; in three 0.17."""
    maps = cells(n, n)
    pairs = neighbours(maps)
    ours = misread(place(n, pairs, dimension, np.random.default_rng(0)), pairs)
    grids = [misread(grid_codes(n, np.random.default_rng(s), dimension), pairs) for s in range(8)]
    assert ours <= 0.8 * np.mean(grids)


def test_three_objects_in_a_row_lie_in_a_row():
    labels = np.repeat([[1, 2, 3]], 40, 0).repeat(40, 1)
    codes = Separated(dimension=1)(maps_of(labels), np.random.default_rng(0))
    assert codes[1, 0] == 0.5
    assert {codes[0, 0], codes[2, 0]} == {0, 1}


def test_auto_takes_as_few_numbers_as_it_needs():
    rows = np.repeat([[1, 2, 3]], 40, 0).repeat(40, 1)
    assert Separated(dimension="auto")(maps_of(rows), np.random.default_rng(0)).shape == (3, 1)
    crowd = cells(40, 0)
    assert Separated(dimension="auto")(crowd, np.random.default_rng(0)).shape == (40, 3)
    assert Separated(dimension="auto", error=1.0)(crowd, np.random.default_rng(0)).shape == (40, 1)


def plain_annealing(points, taken, pairs, weights, moves):
    """Float64, all codes against all balls for every move."""
    taken = taken.copy()
    weights = weights / weights.sum()

    def crowding():
        a, b = points[taken[pairs[:, 0]]], points[taken[pairs[:, 1]]]
        reach = 1.2 * np.abs(a - b).sum(1) / 2
        far = np.abs((a + b)[:, None] / 2 - points[taken]).sum(-1)
        return (weights * np.maximum(1 - far / reach[:, None], 0).sum(1)).sum()

    now = start = crowding()
    for step, (i, target, luck) in enumerate(moves):
        moved = taken.copy()
        moved[taken == target] = taken[i]
        moved[i] = target
        taken, before = moved, taken
        heat = start * 1e-3 * 1e-3 ** (step / len(moves))
        worse = crowding() - now
        if worse > 0 and luck >= np.exp(-worse / heat):
            taken = before
        else:
            now += worse
    return taken


@pytest.mark.parametrize("n", [7, 12])
def test_annealing_takes_the_moves_of_a_plain_one(n):
    rng = np.random.default_rng(n)
    points, moves = _points(n, 3), 1500
    pairs = np.argwhere(np.triu(rng.random((n, n)) < 0.5, 1))
    weights = rng.random(len(pairs))
    weights /= weights.sum()
    first = np.argsort(pairs.ravel(), kind="stable")
    starts = np.searchsorted(pairs.ravel()[first], np.arange(n + 1))
    taken = rng.permutation(len(points))[:n]
    movers, targets = rng.integers(n, size=moves), rng.integers(len(points), size=moves)
    luck = rng.random(moves)
    plain = plain_annealing(
        points, taken, pairs, weights, list(zip(movers, targets, luck, strict=True))
    )
    assert (plain != taken).any()
    points = points.astype(np.float32)
    _anneal(
        points, taken, pairs, *_layout(points, taken, weights), starts, first // 2, movers,
        targets, luck, *HEAT,
    )  # fmt: skip
    np.testing.assert_array_equal(taken, plain)


def test_objects_that_nothing_touches_get_codes_too():
    alone = place(5, Pairs(np.zeros((0, 2), np.int64), np.zeros(0)), 3, np.random.default_rng(0))
    assert len(np.unique(alone, axis=0)) == 5


@pytest.mark.parametrize("error", [-0.1, 1.5, np.nan])
def test_an_error_out_of_range_is_refused(error):
    with pytest.raises(InputError, match=r"separated error: found .*, expected a number"):
        Separated(dimension="auto", error=error)
