"""Bundle adjustment against SciPy's least squares, against differences, and on hard cases."""

from dataclasses import replace

import numpy as np
import pytest
from bundles import reprojection, shaken, true_bundle
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from slgaussian.cameras import bundle as module
from slgaussian.cameras.bundle import Bundle, PosePrior, adjust, homogeneous


def turned_by(bundle: Bundle, truth: Bundle) -> float:
    """Degrees of the worst rotation between two bundles' cameras."""
    off = Rotation.from_matrix(bundle.R @ truth.R.transpose(0, 2, 1))
    return float(np.degrees(off.magnitude().max()))


def moved_by(bundle: Bundle, truth: Bundle) -> float:
    """Degrees of the worst direction of a translation between two bundles' cameras."""
    a, b = (one.t[1:] / np.linalg.norm(one.t[1:], axis=1)[:, None] for one in (bundle, truth))
    return float(np.degrees(np.arccos(np.clip((a * b).sum(1), -1, 1)).max()))


def reference_cost(bundle: Bundle, scale: float) -> float:
    """The cost that SciPy finds when it moves all cameras, points and focal lengths freely."""
    V, N = len(bundle.R), len(bundle.points)

    def residuals(x: np.ndarray) -> np.ndarray:
        turn, t, points, logs = np.split(x, np.cumsum([3 * V - 3, 3 * V - 3, 3 * N]))
        R = bundle.R.copy()
        R[1:] = Rotation.from_rotvec(turn.reshape(-1, 3)).as_matrix() @ bundle.R[1:]
        now = replace(
            bundle,
            R=R,
            t=np.concatenate([bundle.t[:1], t.reshape(-1, 3)]),
            points=points.reshape(-1, 3),
            focals=np.exp(logs),
        )
        # As 3 log(1 + r^2 / s^2) = (root of it)^2, plain least squares minimises the same cost.
        r = reprojection(now)
        r2 = (r**2).sum(1, keepdims=True) / scale**2
        seen = r / scale * np.sqrt(3 * np.log1p(r2) / np.maximum(r2, 1e-12))
        wrong = np.log(now.focals / bundle.focal_prior) / bundle.focal_sigma
        return np.concatenate([seen.ravel(), wrong])

    start = [np.zeros(3 * V - 3), bundle.t[1:], bundle.points, np.log(bundle.focals)]
    flat = np.concatenate([np.ravel(one) for one in start])
    found = least_squares(residuals, flat, method="trf", x_scale="jac", max_nfev=80)
    return 2 * float(found.cost)


@pytest.mark.parametrize(("views", "points", "outliers"), [(2, 14, 0.0), (3, 12, 0.1)])
def test_as_low_a_cost_as_scipy_finds(views, points, outliers):
    truth = true_bundle(views, points, 3, outliers=outliers)
    start = shaken(replace(truth, focal_sigma=np.full(1, 0.3)), 4)
    found = adjust(start, scale=1.0, iterations=200, tolerance=1e-13)
    assert found.cost == pytest.approx(reference_cost(found.bundle, 1.0), rel=1e-6, abs=1e-6)
    assert found.cost <= reference_cost(start, 1.0) * (1 + 1e-6)


@settings(max_examples=25, deadline=None)
@given(st.integers(2, 4), st.integers(1, 8), st.integers(1, 2), st.integers(0, 2**31))
def test_derivatives_are_those_of_differences(views, points, lenses, seed):
    truth = true_bundle(views, points, seed, lenses=lenses)
    start = shaken(truth, seed)
    q = homogeneous(start.points)
    camera, point = module._derivatives(start, q, module._project(start, q))
    columns = module._Layout.of(start).columns[start.view]
    h = 1e-6
    for k in range(6 * views + lenses):
        step = np.zeros(6 * views + lenses)
        step[k] = h
        ends = []
        for sign in (1, -1):
            s = sign * step
            poses = s[: 6 * views].reshape(views, 6)
            moved = replace(
                start,
                R=Rotation.from_rotvec(poses[:, :3]).as_matrix() @ start.R,
                t=start.t + poses[:, 3:],
                focals=start.focals * np.exp(s[6 * views :]),
            )
            ends.append(module._project(moved, q).residuals)
        found = np.einsum("mik,mk->mi", camera, (columns == k).astype(float))
        np.testing.assert_allclose(found, (ends[0] - ends[1]) / (2 * h), atol=1e-3)
    across = module._tangents(q)
    for k in range(3):
        ends = [module._project(start, q + sign * h * across[:, :, k]) for sign in (1, -1)]
        difference = (ends[0].residuals - ends[1].residuals) / (2 * h)
        np.testing.assert_allclose(point[:, :, k], difference, atol=1e-2, rtol=1e-5)


def test_the_prior_of_poses_is_in_its_deviations_and_has_the_derivatives_of_differences():
    truth = true_bundle(3, 4, 1)
    R, t = truth.R, truth.t
    centers = -np.einsum("vji,vj->vi", R, t)
    turn, move = 0.02, np.array([0.1, 0.3, 0.5])
    prior = PosePrior(R, centers, turn, move)
    off = np.random.default_rng(2).normal(0, 1, (3, 6))  # deviations
    turned = Rotation.from_rotvec(off[:, :3] * turn).as_matrix() @ R
    at = centers + off[:, 3:] * move[:, None]
    t = -np.einsum("vij,vj->vi", turned, at)
    np.testing.assert_allclose(prior.pull(turned, t)[0], off, atol=1e-9)
    # Derivatives at the prior itself, where its rotation vector is the step of the camera's.
    _, slopes = prior.pull(R, truth.t)
    h = 1e-6
    for k in range(6):
        step = np.zeros((3, 6))
        step[:, k] = h
        ends = [
            prior.pull(Rotation.from_rotvec(s[:, :3]).as_matrix() @ R, truth.t + s[:, 3:])[0]
            for s in (step, -step)
        ]
        np.testing.assert_allclose(slopes[:, :, k], (ends[0] - ends[1]) / (2 * h), atol=1e-5)


@pytest.mark.parametrize("sigma", [0.01, 0.1])
def test_given_poses_hold_as_much_as_their_prior_says(sigma):
    """A pose that observations tell nothing of stays; one of two priors wins by its precision."""
    truth = true_bundle(2, 60, 21, noise=0.3)
    centers = -np.einsum("vji,vj->vi", truth.R, truth.t)
    wrong = centers + [[0, 0, 0], [0.1, 0, 0]]  # along the baseline, which is free without a prior
    prior = PosePrior(truth.R, wrong, 1e-3, np.array([1e-3, sigma]))
    moved = -np.einsum("vji,vj->vi", (end := adjust(replace(truth, poses=prior)).bundle).R, end.t)
    length = np.linalg.norm(moved[1] - moved[0])
    assert length == pytest.approx(np.linalg.norm(wrong[1] - wrong[0]), abs=2e-3)


def test_without_noise_the_truth_comes_back():
    truth = true_bundle(4, 80, 1, noise=0.0, lenses=2)
    found = adjust(shaken(truth, 2), iterations=100, tolerance=1e-14).bundle
    assert turned_by(found, truth) < 1e-4
    np.testing.assert_allclose(found.t, truth.t, atol=1e-5)
    np.testing.assert_allclose(found.focals, 600, rtol=1e-5)
    told = np.bincount(truth.point) > 1
    np.testing.assert_allclose(found.points[told], truth.points[told], rtol=1e-4, atol=1e-4)


def test_points_near_infinity():
    near = true_bundle(2, 60, 5, noise=0.3)
    far = true_bundle(2, 60, 5, noise=0.3, depths=(1e5, 1e7))
    both = replace(
        near,
        points=np.concatenate([near.points, far.points]),
        view=np.concatenate([near.view, far.view]),
        point=np.concatenate([near.point, far.point + 60]),
        xy=np.concatenate([near.xy, far.xy]),
        focal_sigma=np.zeros(1),
    )
    # Where only their direction is known they start near, and one of them behind the camera.
    start = shaken(both, 6, 0.01)
    start.points[60:] *= 20 / start.points[60:, 2:]
    start.points[60] *= -100
    found = adjust(start)
    assert np.abs(found.residuals).max() < 2
    assert turned_by(found.bundle, near) < 0.1
    assert np.abs(found.bundle.points[60:, 2]).min() > 300


def test_thirty_percent_of_outliers():
    truth = true_bundle(2, 400, 7, outliers=0.3)
    truth = replace(truth, focal_sigma=np.full(1, 0.3))
    found = adjust(shaken(truth, 8, 0.01))
    assert turned_by(found.bundle, truth) < 0.5
    assert moved_by(found.bundle, truth) < 1.5
    assert np.linalg.norm(found.residuals, axis=1).max() > 30


def test_how_far_a_view_stands_is_not_in_which_direction():
    found = adjust(true_bundle(3, 60, 9))
    t = found.bundle.t[2]
    along = np.outer(t, t) / (t @ t)
    covariance = np.zeros_like(found.covariance)
    covariance[15:18, 15:18] = 0.04 * along + 1e-6 * (np.eye(3) - along)
    turned, moved = replace(found, covariance=covariance).degrees(2)
    assert turned == 0
    assert moved == pytest.approx(np.degrees(1e-3 / np.linalg.norm(t)))


def test_fixed_things_stay():
    truth = replace(true_bundle(3, 40, 12, lenses=3), focal_sigma=np.array([0.0, 0.1, np.inf]))
    found = adjust(shaken(truth, 13))
    assert found.bundle.focals[0] == 600 != found.bundle.focals[1]
    assert np.array_equal(found.bundle.R[0], np.eye(3))
    assert not found.bundle.t[0].any()
    assert np.linalg.norm(found.bundle.t[1]) == pytest.approx(np.linalg.norm(truth.t[1]))
    assert found.focal_deviations[0] == 0 < found.focal_deviations[1] < 0.1


def test_many_points_in_pieces_are_the_same(monkeypatch):
    start = shaken(true_bundle(3, 40, 14), 15)
    whole = adjust(start)
    monkeypatch.setattr(module, "_CHUNK", 500)
    np.testing.assert_allclose(adjust(start).bundle.t, whole.bundle.t, atol=1e-8)


@pytest.mark.parametrize("views", [2, 4])
def test_what_is_said_to_be_uncertain_is_as_wrong_as_said(views):
    """Over many draws of the noise, errors divided by what was said of them spread by about one."""
    turned, focal = [], []
    for seed in range(30):
        truth = replace(true_bundle(views, 50, 20, turned=0.3), focal_sigma=np.full(1, 0.3))
        rng = np.random.default_rng(seed)
        clean = replace(truth, xy=reprojection(truth) + truth.xy)
        draw = replace(clean, xy=clean.xy + rng.normal(0, 0.5, clean.xy.shape))
        found = adjust(draw, scale=1.0)
        off = Rotation.from_matrix(found.bundle.R[1] @ truth.R[1].T).as_rotvec()
        turned.append(off @ np.linalg.solve(found.covariance[6:9, 6:9], off) / 3)
        focal.append(np.log(found.bundle.focals[0] / 600) / found.focal_deviations[0])
    assert 0.6 < np.sqrt(np.mean(turned)) < 1.6
    assert 0.6 < np.sqrt(np.mean(np.square(focal))) < 1.6
