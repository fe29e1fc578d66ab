"""Relative poses and focal lengths from matches, their derivatives and uncertainty."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from slgaussian.cameras.epipolar import FocalPrior, TwoViews, linearise, posterior, solve


def two_views(seed: int) -> TwoViews:
    rng = np.random.default_rng(seed)
    R = Rotation.from_rotvec(rng.normal(0, 0.12, 3)).as_matrix()
    t = rng.normal(0, 1, 3) * (1, 1, 0.5)
    return TwoViews(R, t / np.linalg.norm(t), np.full(2, 800.0), np.zeros(0))


def matches(views: TwoViews, count: int, seed: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Make matches of points 4 to 12 baselines away."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(4, 12, count)
    a = np.stack([*rng.uniform(-0.5, 0.5, (2, count)) * z, z], 1)
    b = a @ views.R.T + views.t
    x, y = (p[:, :2] / p[:, 2:] * f for p, f in zip((a, b), views.focals, strict=True))
    return x + rng.normal(0, noise, x.shape), y + rng.normal(0, noise, y.shape)


def prior(sigma: float, mean: float = 800, shared: bool = True) -> FocalPrior:
    return FocalPrior(np.full(2, np.log(mean)), np.full(2, sigma), shared)


@given(st.integers(0, 10**6), st.booleans())
@settings(max_examples=20, deadline=None)
def test_jacobian_matches_central_differences_of_the_distance(seed, shared):
    views, lens = two_views(seed), prior(0.3, shared=shared)
    x, y = matches(views, 12, seed, 2.0)
    views = replace(views, moves=np.zeros(len(lens.directions)))
    distance, J = linearise(views, x, y, lens)
    np.testing.assert_array_equal(distance, views.distance(x, y))
    for column, step in zip(J.T, 1e-6 * np.eye(J.shape[1]), strict=True):
        ends = [views.take_step(s, lens).distance(x, y) for s in (step, -step)]
        np.testing.assert_allclose(column, (ends[0] - ends[1]) / 2e-6, rtol=1e-4, atol=1e-3)


@given(st.integers(0, 10**6))
@settings(max_examples=10, deadline=None)
def test_pose_is_found_among_a_third_of_outliers(seed):
    views = two_views(seed)
    x, y = matches(views, 300, seed, 0.2)
    rng = np.random.default_rng(seed)
    y[::3] = rng.uniform(-480, 480, y[::3].shape)
    best = solve(x, y, prior(0.0))[0]
    assert best.turned_from(views) < 1.0
    assert (best.depths(x[1::3], y[1::3]) > 0).all(0).mean() > 0.98


CONVERGING = Rotation.from_euler("yx", (-14, 5), degrees=True).as_matrix()


@pytest.mark.parametrize("true", [500, 800, 1500])
def test_focal_length_is_found_where_cameras_converge(true):
    t = np.array([1.5, -0.4, 0.3])
    views = TwoViews(CONVERGING, t / np.linalg.norm(t), np.full(2, float(true)), np.zeros(0))
    x, y = matches(views, 600, 1, 0.1)
    best = solve(x, y, prior(0.3, 768))[0]
    assert best.focals[0] == pytest.approx(true, rel=0.06)
    assert best.turned_from(views) < 3


def test_focal_length_of_parallel_axes_keeps_the_deviation_of_its_prior():
    views = TwoViews(np.eye(3), np.array([1.0, 0, 0]), np.full(2, 700.0), np.zeros(0))
    x, y = matches(views, 500, 2, 0.2)
    best = solve(x, y, prior(0.3, 768))[0]
    assert best.focals[0] == pytest.approx(768, rel=0.05)
    assert 0.9 < np.sqrt(best.covariance[5, 5]) < 1.001
    assert abs(best.t[0]) > 0.999


def test_both_poses_that_explain_a_plane_are_returned():
    """More of the eleven starts end at the first pose than solutions are kept."""
    t = np.array([1.0, 0.3, 0.2]) / np.linalg.norm([1.0, 0.3, 0.2])
    views = TwoViews(CONVERGING, t, np.full(2, 800.0), np.zeros(0))
    rng = np.random.default_rng(1)
    rays = np.column_stack([rng.uniform(-0.5, 0.5, (300, 2)), np.ones(300)])
    a = rays * 6 / (rays @ [0.3, 0.2, 1.0])[:, None]
    b = a @ CONVERGING.T + t
    x, y = (800 * p[:, :2] / p[:, 2:] + rng.normal(0, 0.3, (300, 2)) for p in (a, b))
    best, *alternatives = solve(x, y, prior(0.3))
    assert best.turned_from(views) < 2
    assert alternatives and min(pose.turned_from(best) for pose in alternatives) > 3


def test_reversed_translation_is_improbable_as_points_lie_behind_the_cameras():
    """The distances to epipolar lines are the same."""
    views = two_views(9)
    x, y = matches(views, 100, 9, 0.1)
    mirrored = replace(views, t=-views.t)
    np.testing.assert_allclose(mirrored.distance(x, y), -views.distance(x, y))
    assert posterior(mirrored, x, y, 0.5) > 50 * posterior(views, x, y, 0.5)
