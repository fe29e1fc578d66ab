"""Placing three and more views from pairs that were solved."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slgaussian.cameras.epipolar import TwoViews
from slgaussian.cameras.incremental import Placed, Tie, place

CENTER = np.array([400.0, 300.0])


def walk(views: int, points: int = 300, focals: tuple[float, ...] = (600.0,)):
    """Cameras that go sideways along a box of points, and its solved pairs.

    Keypoints of each view stand in an order of their own; a tenth of all matches is false; poses of
    pairs are off by a degree or two, focal lengths by 5 %.
    """
    rng = np.random.default_rng(0)
    X = np.column_stack([rng.uniform(-4, 4 + views, (points, 1)), rng.uniform(-3, 3, (points, 1))])
    X = np.column_stack([X, rng.uniform(4, 9, points)])
    C = np.column_stack([np.arange(views), rng.normal(0, 0.2, (views, 2))])
    R = Rotation.from_rotvec(rng.normal(0, 0.1, (views, 3))).as_matrix()
    keypoints, seen = [], []
    group = np.arange(views) % len(focals)
    for v in range(views):
        local = (X - C[v]) @ R[v].T
        uv = local[:, :2] / local[:, 2:]
        xy = uv * focals[group[v]] + CENTER
        inside = np.flatnonzero((xy > 0).all(1) & (xy < 2 * CENTER).all(1))
        order = rng.permutation(inside)
        keypoints.append(xy[order] + rng.normal(0, 0.3, (len(order), 2)))
        seen.append(order)
    ties = []
    for a in range(views):
        for b in range(a + 1, min(a + 3, views)):
            both, i, j = np.intersect1d(seen[a], seen[b], return_indices=True)
            false = rng.random(len(both)) < 0.1
            j = j.copy()
            j[false] = rng.permutation(j[false])
            turn = R[b] @ R[a].T @ Rotation.from_rotvec(rng.normal(0, 0.01, 3)).as_matrix()
            t = R[b] @ (C[a] - C[b]) + rng.normal(0, 0.02, 3)
            off = [focals[group[v]] * np.exp(rng.normal(0, 0.05)) for v in (a, b)]
            relative = TwoViews(turn, t, np.array(off), np.zeros(0))
            ties.append(Tie((a, b), (i, j), keypoints[b][j], relative, 8.0, 0.9))
    return keypoints, group, R, C, ties


def placed(keypoints, group, ties, sigma=0.3) -> Placed | None:
    lenses = int(group.max()) + 1
    centers = np.tile(CENTER, (len(keypoints), 1))
    return place(keypoints, centers, group, np.full(lenses, 650.0), np.full(lenses, sigma), ties)


def errors(found: Placed, R: np.ndarray, C: np.ndarray) -> tuple[float, float]:
    """Degrees of the worst rotation, and the worst position in first baselines."""
    bundle, order = found.adjusted.bundle, found.order
    true = R[order] @ R[order[0]].T
    off = Rotation.from_matrix(bundle.R @ true.transpose(0, 2, 1)).magnitude()
    at = -np.einsum("vji,vj->vi", bundle.R, bundle.t)
    where = (C[order] - C[order[0]]) @ R[order[0]].T / np.linalg.norm(C[order[1]] - C[order[0]])
    return float(np.degrees(off.max())), float(np.linalg.norm(at - where, axis=1).max())


@pytest.mark.parametrize("views", [3, 6])
def test_all_views_are_placed(views):
    keypoints, group, R, C, ties = walk(views)
    found = placed(keypoints, group, ties)
    assert sorted(found.order) == list(range(views))
    turned, moved = errors(found, R, C)
    assert turned < 0.5
    assert moved < 0.05 * views
    assert found.adjusted.bundle.focals == pytest.approx(600, rel=0.02)
    assert np.median(np.abs(found.adjusted.residuals)) < 0.4
    assert (np.bincount(found.adjusted.bundle.point) > 1).all()


def test_a_view_of_another_place_is_left_out():
    keypoints, group, R, C, ties = walk(5)
    rng = np.random.default_rng(1)
    keypoints.append(rng.uniform(0, 600, (80, 2)))
    i, j = rng.permutation(60), rng.permutation(60)
    ties.append(replace(ties[0], views=(4, 5), features=(i, j), xy=keypoints[5][j]))
    found = placed(keypoints, np.append(group, 0), ties)
    assert sorted(found.order) == [0, 1, 2, 3, 4]
    assert errors(found, R, C)[0] < 0.5


def test_the_place_of_most_views_is_taken():
    """Even though every pair of the other one would be a better start."""
    keypoints, _, R, C, ties = walk(5)
    fewer, _, _, _, better = walk(4, 600)
    ties = [replace(tie, confidence=0.5) for tie in ties]
    ties += [replace(tie, views=(tie.views[0] + 5, tie.views[1] + 5)) for tie in better]
    found = placed([*keypoints, *fewer], np.zeros(9, int), ties)
    assert sorted(found.order) == [0, 1, 2, 3, 4]
    assert errors(found, R, C)[0] < 0.5


def test_a_view_that_explains_few_of_its_matches_is_left_out():
    keypoints, group, _, _, ties = walk(5, 1500)
    rng = np.random.default_rng(2)
    lost = rng.random(len(keypoints[4])) < 0.85
    keypoints[4] = np.where(lost[:, None], rng.uniform(0, 600, keypoints[4].shape), keypoints[4])
    ties = [replace(tie, xy=keypoints[tie.views[1]][tie.features[1]]) for tie in ties]
    assert sorted(placed(keypoints, group, ties).order) == [0, 1, 2, 3]


@pytest.mark.parametrize("confidence", [0.9, 0.3])
def test_few_points_place_a_view_only_with_a_pair_that_is_trusted(confidence):
    keypoints, group, _, _, ties = walk(5)
    shared = np.intersect1d(*[tie.features[1] for tie in ties if tie.views[1] == 4])[:14]
    for k, tie in enumerate(ties):
        if tie.views[1] == 4:
            kept = np.isin(tie.features[1], shared)
            features = tie.features[0][kept], tie.features[1][kept]
            ties[k] = replace(tie, features=features, xy=tie.xy[kept], confidence=confidence)
    found = placed(keypoints, group, ties)
    assert sorted(found.order) == [0, 1, 2, 3] + [4] * (confidence > 0.5)


def test_a_wrong_pair_does_not_spoil_the_others():
    keypoints, group, R, C, ties = walk(5)
    turned = Rotation.from_rotvec([0, 0.5, 0]).as_matrix()
    first = ties[0].relative
    ties[0] = replace(ties[0], relative=replace(first, R=turned @ first.R, t=-first.t))
    found = placed(keypoints, group, ties)
    assert len(found.order) == 5
    assert errors(found, R, C)[0] < 0.5


def test_matches_alone_hold_a_view_that_only_turned():
    """Of the last view only what it shares with its neighbours is known, not a pose."""
    keypoints, group, R, C, ties = walk(4)
    ties = [replace(tie, relative=None, confidence=0.0) if 3 in tie.views else tie for tie in ties]
    found = placed(keypoints, group, ties)
    assert sorted(found.order) == [0, 1, 2, 3]
    assert errors(found, R, C)[0] < 0.5
