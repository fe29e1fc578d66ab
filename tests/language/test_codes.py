"""ID codes: distinct points of the cube; separated ones keep mixtures from third objects."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.errors import InputError
from slgaussian.labels import LabelMaps
from slgaussian.language import load_codes
from slgaussian.language.codes import (
    Pairs,
    Separated,
    _anneal,
    checkerboard,
    grid_codes,
    neighbours,
    place,
)
from slgaussian.language.configs import CODES
from slgaussian.language.nearest import nearest_code


@pytest.mark.parametrize(
    ("n", "side"),
    [(2, 2), (8, 2), (9, 3), (27, 3), (28, 4), (1000, 10), (1001, 11), (10_000, 22)],
)
def test_grid_codes_are_distinct_points_of_the_smallest_grid(n, side):
    codes = grid_codes(n, np.random.default_rng(0))
    assert codes.shape == (n, 3) and codes.dtype == np.float32
    assert len(np.unique(codes, axis=0)) == n
    steps = codes * (side - 1)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-5)
    assert codes.min() >= 0 and codes.max() <= 1
    if n == side**3:
        assert all(len(np.unique(codes[:, axis])) == side for axis in range(3))
    centre = grid_codes(1, np.random.default_rng(0))
    np.testing.assert_array_equal(centre, [[0.5, 0.5, 0.5]])


def label_maps(labels: np.ndarray) -> LabelMaps:
    labels = np.asarray(labels, np.int32)
    labels = labels if labels.ndim == 3 else labels[None]
    return LabelMaps(labels, np.ones(labels.shape, np.float32))


def make_maps(n: int) -> LabelMaps:
    """Two views of ``n`` small squares side by side, ids far apart."""
    side = int(np.ceil(np.sqrt(n)))
    squares = np.arange(side * side).reshape(side, side) * 7 + 3
    squares[squares > 7 * (n - 1) + 3] = 0
    labels = np.kron(squares, np.ones((3, 3), np.int64))
    return label_maps(np.stack([labels, np.roll(labels, 1, 1)]))


@pytest.mark.parametrize("name", sorted(CODES))
@pytest.mark.parametrize("n", [1, 2, 3, 27, 28, 10_000])
def test_code_strategies_give_distinct_codes(name, n):
    maps = make_maps(n)
    assert len(maps.ids) == n
    codes, repeated = (load_codes(name)(maps, np.random.default_rng(4)) for _ in range(2))
    assert codes.dtype == np.float32
    assert codes.tobytes() == repeated.tobytes()
    assert codes.shape == (n, 3)
    assert len(np.unique(codes, axis=0)) == n
    assert 0 <= codes.min() <= codes.max() <= 1
    with pytest.raises(InputError, match="no object"):
        load_codes(name)(label_maps(np.zeros((4, 4))), np.random.default_rng(0))


def cells(n: int, seed: int) -> LabelMaps:
    """Two views of a picture cut into ``n`` cells around random points."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform(0, 80, (n, 2))
    rows, columns = np.indices((80, 80))
    far = np.hypot(rows[..., None] - centres[:, 0], columns[..., None] - centres[:, 1])
    labels = far.argmin(-1) + 1
    return label_maps(np.stack([labels, np.roll(labels, 2, 1)]))


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_mixture_decodes_to_a_third_code_only_inside_the_ball(seed):
    """The assumption of the placement, tested with 200 mixtures of two codes."""
    rng = np.random.default_rng(seed)
    a, b, c = codes = rng.random((3, 3))
    far, radius = np.abs((a + b) / 2 - c).sum(), np.abs(a - b).sum() / 2
    if abs(far - radius) < 1e-3:
        return
    shares = np.linspace(0, 1, 401)[:, None]
    third = (nearest_code((1 - shares) * a + shares * b, codes) == 2).any()
    assert third == (far < radius)


def test_neighbours_count_pairs_across_unlabelled_pixels():
    labels = np.zeros((3, 9), np.int64)
    labels[:, 0:2], labels[:, 2:4], labels[:, 6:9] = 5, 8, 11
    pairs = neighbours(label_maps(labels))
    assert pairs.rows.tolist() == [[0, 1], [0, 2], [1, 2]]
    by_hand = np.zeros(3)
    for gap in (1, 2, 4, 8):
        for u in range(9 - gap):
            labels_of_pair = {labels[0, u], labels[0, u + gap]}
            for k, pair in enumerate(({5, 8}, {5, 11}, {8, 11})):
                by_hand[k] += (labels_of_pair == pair) / gap**2
    np.testing.assert_allclose(pairs.weights, by_hand / by_hand.sum())


@settings(max_examples=20, deadline=None)
@given(st.integers(2, 25), st.integers(0, 2**32 - 1))
def test_separated_codes_do_not_depend_on_ids(n, seed):
    maps = cells(n, seed)
    names = np.cumsum(np.random.default_rng(seed).integers(1, 10**7, n)).astype(np.int64)
    renamed = label_maps(names[maps.labels - 1]) if len(maps.ids) == n else maps
    codes = [Separated()(m, np.random.default_rng(1)) for m in (maps, renamed)]
    np.testing.assert_array_equal(*codes)


def measure_confusion(codes: np.ndarray, pairs: Pairs) -> float:
    """Compute the fraction of mixtures of two neighbours that decode to a third object."""
    a, b = pairs.rows.T
    shares = ((np.arange(16) + 0.5) / 16)[:, None, None]
    nearest = nearest_code((1 - shares) * codes[a] + shares * codes[b], codes)
    return float((((nearest != a) & (nearest != b)) * pairs.weights).sum() / 16)


def test_separated_codes_confuse_fewer_mixtures_than_grid_codes():
    """Measured: 0.17 of it."""
    pairs = neighbours(cells(20, 20))
    ours = measure_confusion(place(20, pairs, np.random.default_rng(0)), pairs)
    grids = [measure_confusion(grid_codes(20, np.random.default_rng(s)), pairs) for s in range(8)]
    assert ours <= 0.3 * np.mean(grids)


def anneal_plainly(points, assignment, pairs, weights, moves):
    """Float64, all codes against all balls for every move."""
    assignment = assignment.copy()
    weights = weights / weights.sum()

    def crowding():
        a, b = points[assignment[pairs[:, 0]]], points[assignment[pairs[:, 1]]]
        reach = 1.2 * np.abs(a - b).sum(1) / 2
        far = np.abs((a + b)[:, None] / 2 - points[assignment]).sum(-1)
        return (weights * np.maximum(1 - far / reach[:, None], 0).sum(1)).sum()

    now = start = crowding()
    for step, (i, target, luck) in enumerate(moves):
        moved = assignment.copy()
        moved[assignment == target] = assignment[i]
        moved[i] = target
        assignment, before = moved, assignment
        heat = start * 1e-3 * 1e-3 ** (step / len(moves))
        worse = crowding() - now
        if worse > 0 and luck >= np.exp(-worse / heat):
            assignment = before
        else:
            now += worse
    return assignment


@pytest.mark.parametrize("n", [7, 12])
def test_annealing_equals_the_float64_reference(n):
    rng = np.random.default_rng(n)
    points, moves = checkerboard(n), 1500
    pairs = np.argwhere(np.triu(rng.random((n, n)) < 0.5, 1))
    weights = rng.random(len(pairs))
    weights /= weights.sum()
    assignment = rng.permutation(len(points))[:n]
    draws = rng.integers(n, size=moves), rng.integers(len(points), size=moves), rng.random(moves)
    plain = anneal_plainly(
        points.astype(float), assignment, pairs, weights, list(zip(*draws, strict=True))
    )
    assert (plain != assignment).any()
    _anneal(points, assignment, pairs, weights.astype(np.float32), *draws)
    np.testing.assert_array_equal(assignment, plain)


def test_separated_codes_of_isolated_objects_are_distinct():
    labels = np.zeros((1, 200))
    labels[0, ::40] = [1, 2, 3, 4, 5]
    alone = Separated()(label_maps(labels), np.random.default_rng(0))
    assert len(np.unique(alone, axis=0)) == 5
