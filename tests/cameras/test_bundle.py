"""Bundle adjustment against SciPy's least squares and finite differences, and on hard cases."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from slgaussian.cameras import bundle as module
from slgaussian.cameras.bundle import Bundle, PosePrior, adjust, homogeneous


def true_bundle(
    views: int, points: int, seed: int, *, noise=0.5, outliers=0.0, turned=0.1,
    depths=(4.0, 9.0), lenses=1, sigma=np.inf,
) -> Bundle:  # fmt: skip
    """Return cameras side by side, points in front of them and noisy observations."""
    rng = np.random.default_rng(seed)
    R = Rotation.from_rotvec(rng.normal(0, turned, (views, 3))).as_matrix()
    R[0] = np.eye(3)
    centers = rng.normal(0, 0.5, (views, 3))
    centers[0], centers[1] = 0, [1, 0.1, 0.05]
    z = rng.uniform(*depths, points)
    xy = rng.uniform(-0.5, 0.5, (points, 2)) * z[:, None]
    view, point = np.nonzero(rng.random((views, points)) < (1.0 if views == 2 else 0.7))
    empty = Bundle(
        R=R,
        t=-(R @ centers[:, :, None])[..., 0],
        centers=np.full((views, 2), [400.0, 300.0]),
        group=np.arange(views) % lenses,
        focals=np.full(lenses, 600.0),
        points=np.column_stack([xy, z]),
        view=view,
        point=point,
        xy=np.zeros((len(view), 2)),
        focal_prior=np.full(lenses, 600.0),
        focal_sigma=np.full(lenses, sigma),
    )
    observed = reprojection(empty) + rng.normal(0, noise, (len(view), 2))
    wrong = rng.random(len(view)) < outliers
    observed[wrong] += rng.uniform(-200, 200, (wrong.sum(), 2))
    return replace(empty, xy=observed)


def reprojection(bundle: Bundle) -> np.ndarray:
    """Return projected minus observed positions [M, 2], pixels."""
    local = (bundle.R[bundle.view] @ bundle.points[bundle.point][:, :, None])[..., 0]
    local += bundle.t[bundle.view]
    focals = bundle.focals[bundle.group[bundle.view]]
    uv = local[:, :2] / local[:, 2:] * focals[:, None]
    return uv + bundle.centers[bundle.view] - bundle.xy


def perturb(bundle: Bundle, seed: int, sigma: float = 0.02) -> Bundle:
    """Perturb everything but the observations and the gauge."""
    rng = np.random.default_rng(seed)
    views = len(bundle.R)
    turned = rng.normal(0, sigma, (views, 3))
    turned[0] = 0
    length = np.linalg.norm(bundle.t[1])
    t = bundle.t + rng.normal(0, sigma, (views, 3)) * length
    t[0] = 0
    t[1] *= length / np.linalg.norm(t[1])
    free = bundle.focal_sigma > 0
    return replace(
        bundle,
        R=Rotation.from_rotvec(turned).as_matrix() @ bundle.R,
        t=t,
        focals=bundle.focals * np.exp(free * rng.normal(0, 2 * sigma, len(bundle.focals))),
        points=bundle.points * np.exp(rng.normal(0, sigma, (len(bundle.points), 1))),
    )


def apply_step(bundle: Bundle, step: np.ndarray) -> Bundle:
    """Apply a step of the cameras [6 V + G], in the order of the covariance."""
    poses, logs = np.split(step, [6 * len(bundle.R)])
    turns, moves = np.split(poses.reshape(-1, 6), 2, axis=1)
    R = Rotation.from_rotvec(turns).as_matrix() @ bundle.R
    return replace(bundle, R=R, t=bundle.t + moves, focals=bundle.focals * np.exp(logs))


def central_differences(function, count: int) -> np.ndarray:
    """Return the derivatives at 0 of a function of ``count`` numbers, on the last axis."""
    steps = 1e-6 * np.eye(count)
    return np.stack([(function(step) - function(-step)) / 2e-6 for step in steps], -1)


def rotation_error(bundle: Bundle, truth: Bundle) -> float:
    """Return the largest angle between two bundles' cameras, degrees."""
    error = Rotation.from_matrix(bundle.R @ truth.R.transpose(0, 2, 1))
    return float(np.degrees(error.magnitude().max()))


def compute_centers(bundle: Bundle) -> np.ndarray:
    return -np.einsum("vji,vj->vi", bundle.R, bundle.t)


def reference_cost(bundle: Bundle, scale: float) -> float:
    """Return SciPy's minimum over all cameras, points and focal lengths."""
    V, N = len(bundle.R), len(bundle.points)

    def residuals(x: np.ndarray) -> np.ndarray:
        turn, t, points, logs = np.split(x, np.cumsum([3 * V, 3 * V, 3 * N]))
        R = Rotation.from_rotvec(turn.reshape(-1, 3)).as_matrix() @ bundle.R
        t, points = t.reshape(-1, 3), points.reshape(-1, 3)
        moved = replace(bundle, R=R, t=t, points=points, focals=np.exp(logs))
        # Least squares of the root of 3 log(1 + r^2 / s^2) minimises the same robust cost.
        r = reprojection(moved)
        r2 = (r**2).sum(1, keepdims=True) / scale**2
        weighted = r / scale * np.sqrt(3 * np.log1p(r2) / np.maximum(r2, 1e-12))
        priors = [np.log(moved.focals / bundle.focal_prior) / bundle.focal_sigma]
        if bundle.poses is not None:
            priors.append(bundle.poses.pull(R, t)[0].ravel())
        return np.concatenate([weighted.ravel(), *priors])

    start = np.zeros(3 * V), bundle.t.ravel(), bundle.points.ravel(), np.log(bundle.focals)
    result = least_squares(residuals, np.concatenate(start), x_scale="jac", max_nfev=80)
    return 2 * float(result.cost)


@pytest.mark.parametrize(
    ("views", "points", "outliers", "lenses", "posed"),
    [(2, 14, 0.0, 1, False), (3, 12, 0.1, 2, False), (3, 12, 0.1, 1, True)],
)
def test_cost_equals_the_minimum_of_scipy(views, points, outliers, lenses, posed):
    truth = true_bundle(views, points, 3, outliers=outliers, lenses=lenses, sigma=0.3)
    start = perturb(truth, 4)
    if posed:
        prior = PosePrior(start.R, compute_centers(start), 0.01, np.array([0.01, 0.02, 0.03]))
        start = replace(start, poses=prior)
    result = adjust(start, scale=1.0, iterations=200, tolerance=1e-13)
    assert result.cost == pytest.approx(reference_cost(result.bundle, 1.0), rel=1e-6, abs=1e-6)
    assert result.cost <= reference_cost(start, 1.0) * (1 + 1e-6)
    if posed:
        assert (np.sqrt(np.diag(result.covariance)[:3]) < 0.01).all()


@settings(max_examples=25, deadline=None)
@given(
    st.integers(2, 4), st.integers(1, 8), st.integers(1, 2), st.booleans(), st.integers(0, 2**31)
)
@example(3, 1, 1, False, 2**31 - 1)  # no point is observed
def test_derivatives_match_central_differences(views, points, lenses, posed, seed):
    start = perturb(true_bundle(views, points, seed, lenses=lenses, sigma=0.3), seed)
    start = replace(start, points=homogeneous(start.points))
    if posed:
        prior = PosePrior(start.R, compute_centers(start) + 0.1, 0.1, np.linspace(0.1, 0.3, views))
        start = replace(start, poses=prior)
    problem = module._Problem(start, 1.0)
    state = problem.project(start)
    camera, point = problem.derivatives(state)
    count = 6 * views + lenses

    def project(step):
        return problem.project(apply_step(start, step))

    columns = problem.columns[start.view][:, :, None] == np.arange(count)
    expected = central_differences(lambda step: project(step).residuals, count)
    np.testing.assert_allclose(np.einsum("mik,mkp->mip", camera, columns), expected, atol=1e-3)
    gradient = -2 * problem.normal(state).camera_side
    slopes = central_differences(lambda step: project(step).cost, count)
    np.testing.assert_allclose(gradient, slopes, rtol=1e-4, atol=1e-2)
    tangents = module._tangents(start.points)

    def residuals(step):
        return problem.project(replace(start, points=start.points + tangents @ step)).residuals

    expected = central_differences(residuals, 3)
    np.testing.assert_allclose(point, expected, atol=1e-2, rtol=1e-5)


def test_pose_prior_is_in_deviations_and_its_derivatives_match_central_differences():
    truth = true_bundle(3, 4, 1)
    turn, move = 0.02, np.array([0.1, 0.3, 0.5])
    deviations = np.random.default_rng(2).normal(0, 1, (3, 6))
    R = Rotation.from_rotvec(deviations[:, :3] * turn).as_matrix() @ truth.R
    t = -np.einsum("vij,vj->vi", R, compute_centers(truth) + deviations[:, 3:] * move[:, None])
    prior = PosePrior(truth.R, compute_centers(truth), turn, move)
    np.testing.assert_allclose(prior.pull(R, t)[0], deviations, atol=1e-9)
    # At the prior itself, its rotation vector is the camera's step.
    _, slopes = prior.pull(truth.R, truth.t)

    def pull(step):
        moved = apply_step(truth, np.append(np.tile(step, 3), 0))
        return prior.pull(moved.R, moved.t)[0]

    np.testing.assert_allclose(slopes, central_differences(pull, 6), atol=1e-5)


def test_exact_observations_restore_the_truth(monkeypatch):
    truth = true_bundle(4, 80, 1, noise=0.0, lenses=2)
    start = perturb(truth, 2)
    for chunk in (module._CHUNK, 500):  # all points at once, and in pieces
        monkeypatch.setattr(module, "_CHUNK", chunk)
        result = adjust(start, iterations=100, tolerance=1e-14).bundle
        assert rotation_error(result, truth) < 1e-4
        np.testing.assert_allclose(result.t, truth.t, atol=1e-5)
        np.testing.assert_allclose(result.focals, 600, rtol=1e-5)
        triangulated = np.bincount(truth.point) > 1
        points, expected = result.points[triangulated], truth.points[triangulated]
        np.testing.assert_allclose(points, expected, rtol=1e-4, atol=1e-4)


def test_points_near_infinity_converge():
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
    # Only directions of the far points are known: they start near, one behind the camera.
    start = perturb(both, 6, 0.01)
    start.points[60:] *= 20 / start.points[60:, 2:]
    start.points[60] *= -100
    result = adjust(start)
    assert np.abs(result.residuals).max() < 2
    assert rotation_error(result.bundle, near) < 0.1
    assert np.abs(result.bundle.points[60:, 2]).min() > 300


def test_thirty_percent_of_outliers_are_rejected():
    truth = true_bundle(2, 400, 7, outliers=0.3, sigma=0.3)
    result = adjust(perturb(truth, 8, 0.01))
    assert rotation_error(result.bundle, truth) < 0.5
    a, b = (bundle.t[1] / np.linalg.norm(bundle.t[1]) for bundle in (result.bundle, truth))
    assert a @ b > np.cos(np.radians(1.5))
    np.testing.assert_allclose(result.residuals, reprojection(result.bundle), atol=1e-6)
    assert np.linalg.norm(result.residuals, axis=1).max() > 30


def test_uncertain_distance_does_not_count_as_uncertain_direction():
    result = adjust(true_bundle(3, 60, 9))
    t = result.bundle.t[2]
    along_t = np.outer(t, t) / (t @ t)
    covariance = np.zeros_like(result.covariance)
    covariance[15:18, 15:18] = 0.04 * along_t + 1e-6 * (np.eye(3) - along_t)
    expected = 0, np.degrees(1e-3 / np.linalg.norm(t))
    assert replace(result, covariance=covariance).degrees(2) == pytest.approx(expected)


def test_gauge_and_fixed_focal_lengths_stay():
    truth = replace(true_bundle(3, 40, 12, lenses=3), focal_sigma=np.array([0.0, 0.1, np.inf]))
    result = adjust(perturb(truth, 13))
    assert result.bundle.focals[0] == 600 != result.bundle.focals[1]
    assert np.array_equal(result.bundle.R[0], np.eye(3))
    assert not result.bundle.t[0].any()
    assert np.linalg.norm(result.bundle.t[1]) == pytest.approx(np.linalg.norm(truth.t[1]))
    assert result.focal_deviations[0] == 0 < result.focal_deviations[1] < 0.1


@pytest.mark.parametrize("views", [2, 4])
def test_covariance_predicts_errors_over_many_draws_of_noise(views):
    turned, focal = [], []
    truth = true_bundle(views, 50, 20, turned=0.3, sigma=0.3)
    clean = reprojection(truth) + truth.xy
    for seed in range(30):
        noise = np.random.default_rng(seed).normal(0, 0.5, clean.shape)
        result = adjust(replace(truth, xy=clean + noise), scale=1.0)
        error = Rotation.from_matrix(result.bundle.R[1] @ truth.R[1].T).as_rotvec()
        turned.append(error @ np.linalg.solve(result.covariance[6:9, 6:9], error) / 3)
        focal.append(np.log(result.bundle.focals[0] / 600) / result.focal_deviations[0])
    assert 0.6 < np.sqrt(np.mean(turned)) < 1.6
    assert 0.6 < np.sqrt(np.mean(np.square(focal))) < 1.6
