"""Incremental placement of three and more views from solved pairs."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slgaussian.cameras.epipolar import TwoViews
from slgaussian.cameras.incremental import Placed, Tie, place

CENTER = np.array([400.0, 300.0])


def walk(views: int, points: int = 300):
    """Make cameras that go sideways along a box of points, and their solved pairs.

    Keypoints are shuffled; a tenth of the matches is false; poses of pairs are off by a degree or
    two, focal lengths by 5 %.
    """
    rng = np.random.default_rng(0)
    X = np.column_stack([rng.uniform(-4, 4 + views, (points, 1)), rng.uniform(-3, 3, (points, 1))])
    X = np.column_stack([X, rng.uniform(4, 9, points)])
    C = np.column_stack([np.arange(views), rng.normal(0, 0.2, (views, 2))])
    R = Rotation.from_rotvec(rng.normal(0, 0.1, (views, 3))).as_matrix()
    keypoints, visible = [], []
    for v in range(views):
        local = (X - C[v]) @ R[v].T
        xy = local[:, :2] / local[:, 2:] * 600 + CENTER
        inside = np.flatnonzero((xy > 0).all(1) & (xy < 2 * CENTER).all(1))
        order = rng.permutation(inside)
        keypoints.append(xy[order] + rng.normal(0, 0.3, (len(order), 2)))
        visible.append(order)
    ties = []
    for a in range(views):
        for b in range(a + 1, min(a + 3, views)):
            common, i, j = np.intersect1d(visible[a], visible[b], return_indices=True)
            false = rng.random(len(common)) < 0.1
            j = j.copy()
            j[false] = rng.permutation(j[false])
            turn = R[b] @ R[a].T @ Rotation.from_rotvec(rng.normal(0, 0.01, 3)).as_matrix()
            t = R[b] @ (C[a] - C[b]) + rng.normal(0, 0.02, 3)
            focals = 600 * np.exp(rng.normal(0, 0.05, 2))
            relative = TwoViews(turn, t, focals, np.zeros(0))
            ties.append(Tie((a, b), (i, j), relative, 8.0, 0.9))
    return keypoints, R, C, ties


def place_all(keypoints, ties) -> Placed | None:
    """Place views of one lens, whose focal length is not known exactly."""
    count = len(keypoints)
    centers, group = np.tile(CENTER, (count, 1)), np.zeros(count, int)
    return place(keypoints, centers, group, np.array([650.0]), np.array([0.3]), ties)


def errors(placed: Placed, R: np.ndarray, C: np.ndarray) -> tuple[float, float]:
    """Return the largest errors of rotation, degrees, and of position, in first baselines."""
    bundle, order = placed.adjusted.bundle, placed.order
    true_R = R[order] @ R[order[0]].T
    angle = Rotation.from_matrix(bundle.R @ true_R.transpose(0, 2, 1)).magnitude()
    true_C = (C[order] - C[order[0]]) @ R[order[0]].T / np.linalg.norm(C[order[1]] - C[order[0]])
    distance = np.linalg.norm(-np.einsum("vji,vj->vi", bundle.R, bundle.t) - true_C, axis=1)
    return float(np.degrees(angle.max())), float(distance.max())


@pytest.mark.parametrize("views", [3, 6])
def test_all_views_are_placed(views):
    keypoints, R, C, ties = walk(views)
    placed = place_all(keypoints, ties)
    assert sorted(placed.order) == list(range(views))
    angle, distance = errors(placed, R, C)
    assert angle < 0.5 and distance < 0.05 * views
    assert placed.adjusted.bundle.focals == pytest.approx(600, rel=0.02)
    assert np.median(np.abs(placed.adjusted.residuals)) < 0.4
    assert (np.bincount(placed.adjusted.bundle.point) > 1).all()


def test_view_of_another_place_is_left_out():
    keypoints, R, C, ties = walk(5)
    rng = np.random.default_rng(1)
    keypoints.append(rng.uniform(0, 600, (80, 2)))
    i, j = rng.permutation(60), rng.permutation(60)
    ties.append(replace(ties[0], views=(4, 5), features=(i, j)))
    placed = place_all(keypoints, ties)
    assert sorted(placed.order) == [0, 1, 2, 3, 4]
    assert errors(placed, R, C)[0] < 0.5


def test_larger_of_two_places_wins_over_better_pairs():
    keypoints, R, C, ties = walk(5)
    smaller, _, _, better = walk(4, 600)
    ties = [replace(tie, confidence=0.5) for tie in ties]
    ties += [replace(tie, views=(tie.views[0] + 5, tie.views[1] + 5)) for tie in better]
    placed = place_all([*keypoints, *smaller], ties)
    assert sorted(placed.order) == [0, 1, 2, 3, 4]
    assert errors(placed, R, C)[0] < 0.5


def test_view_that_explains_few_of_its_matches_is_left_out():
    keypoints, _, _, ties = walk(5, 1500)
    rng = np.random.default_rng(2)
    lost = rng.random(len(keypoints[4])) < 0.85
    keypoints[4] = np.where(lost[:, None], rng.uniform(0, 600, keypoints[4].shape), keypoints[4])
    assert sorted(place_all(keypoints, ties).order) == [0, 1, 2, 3]


@pytest.mark.parametrize("confidence", [0.9, 0.3])
def test_few_points_place_a_view_only_with_a_confident_pair(confidence):
    keypoints, _, _, ties = walk(5)
    shared = np.intersect1d(*[tie.features[1] for tie in ties if tie.views[1] == 4])[:14]
    for k, tie in enumerate(ties):
        if tie.views[1] == 4:
            mask = np.isin(tie.features[1], shared)
            features = tie.features[0][mask], tie.features[1][mask]
            ties[k] = replace(tie, features=features, confidence=confidence)
    placed = place_all(keypoints, ties)
    assert sorted(placed.order) == [0, 1, 2, 3] + [4] * (confidence > 0.5)


def test_wrong_pair_does_not_affect_the_other_views():
    keypoints, R, C, ties = walk(5)
    turned = Rotation.from_rotvec([0, 0.5, 0]).as_matrix()
    first = ties[0].relative
    ties[0] = replace(ties[0], relative=replace(first, R=turned @ first.R, t=-first.t))
    placed = place_all(keypoints, ties)
    assert len(placed.order) == 5
    assert errors(placed, R, C)[0] < 0.5


def test_matches_without_a_pose_place_a_view():
    keypoints, R, C, ties = walk(4)
    ties = [replace(tie, relative=None, confidence=0.0) if 3 in tie.views else tie for tie in ties]
    placed = place_all(keypoints, ties)
    assert sorted(placed.order) == [0, 1, 2, 3]
    assert errors(placed, R, C)[0] < 0.5
