"""Robust bundle adjustment: minimise the reprojection error over cameras and points.

Levenberg-Marquardt on the Schur complement over the points (Triggs et al. 1999, "Bundle adjustment:
a modern synthesis"), in float64. Points move on the unit sphere of homogeneous coordinates, which
keeps points near infinity well conditioned. Observation errors follow a two-dimensional Cauchy
distribution: gross outliers have almost no weight, and the cost is a posterior in which priors have
their proper weight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from slgaussian.io import short_repr

_LOCAL = 7
"""Parameters of a camera that one observation depends on: rotation, t, log focal length."""

_CHUNK = 1 << 21
"""Largest number of elements of the dense point-camera blocks in memory at once."""


@dataclass(frozen=True, eq=False)
class PosePrior:
    """Prior of camera poses, which fixes the world frame and the scale.

    Attributes:
        R, centers: float64 [V, 3, 3], [V, 3]. World-to-camera rotations and camera centres.
        turn: Standard deviation of each rotation about each axis, radians.
        move: float64 [V]. Standard deviation of each centre along each axis, scene units.
    """

    R: np.ndarray
    centers: np.ndarray
    turn: float
    move: np.ndarray

    __repr__ = short_repr

    def pull(self, R: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return residuals of poses in standard deviations [V, 6], and derivatives [V, 6, 6]."""
        back = R.transpose(0, 2, 1)
        turned = Rotation.from_matrix(R @ self.R.transpose(0, 2, 1)).as_rotvec()
        moved = -(back @ t[:, :, None])[..., 0] - self.centers
        slopes = np.zeros((len(R), 6, 6))
        slopes[:, :3, :3] = np.eye(3) / self.turn
        # The update rotates the world about the camera centre, so t changes with the rotation.
        slopes[:, 3:, :3] = -back @ _cross_matrices(t) / self.move[:, None, None]
        slopes[:, 3:, 3:] = -back / self.move[:, None, None]
        return np.concatenate([turned / self.turn, moved / self.move[:, None]], 1), slopes


@dataclass(frozen=True, eq=False)
class Bundle:
    """Cameras, points and observations of the points.

    Without a pose prior the world is the frame of the first camera: its pose is the identity.

    Attributes:
        R, t: float64 [V, 3, 3], [V, 3]. World to camera, OpenCV axes. Without a pose prior the
            length of ``t[1]`` is constant, which fixes the scale.
        centers: float64 [V, 2]. Principal points, pixels; constant.
        group: int64 [V]. Index of the focal length of each view.
        focals: float64 [G]. Pixels.
        points: float64 [N, 3]
        view, point: int64 [M]. View and point of each observation; each pair occurs at most once.
        xy: float64 [M, 2]. Observed pixels.
        focal_prior, focal_sigma: float64 [G]. Normal prior of the logarithm of each focal length:
            its centre in pixels, and its standard deviation; 0 fixes the focal length, infinity
            removes the prior.
    """

    R: np.ndarray
    t: np.ndarray
    centers: np.ndarray
    group: np.ndarray
    focals: np.ndarray
    points: np.ndarray
    view: np.ndarray
    point: np.ndarray
    xy: np.ndarray
    focal_prior: np.ndarray
    focal_sigma: np.ndarray
    poses: PosePrior | None = None

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Result of :func:`adjust`.

    Attributes:
        cost: Minus twice the log posterior, up to a constant.
        residuals: float64 [M, 2]. Pixels.
        covariance: float64 [6 V + G, 6 V + G]. Covariance of all camera parameters, with the noise
            level of the residuals: for each view a rotation vector (camera axes, applied after
            ``R``) and ``t``, then the logarithm of each focal length. Rows and columns of fixed
            parameters are 0.
    """

    bundle: Bundle
    cost: float
    residuals: np.ndarray
    covariance: np.ndarray

    __repr__ = short_repr

    @cached_property
    def focal_deviations(self) -> np.ndarray:
        """Return the standard deviation of the logarithm of each focal length: float64 [G]."""
        return np.sqrt(np.diag(self.covariance)[6 * len(self.bundle.R) :])

    def degrees(self, view: int) -> tuple[float, float]:
        """Return the standard deviations of a view's rotation and direction of ``t`` relative to
        the first view, degrees, along the least certain axis."""
        block = self.covariance[6 * view : 6 * view + 6, 6 * view : 6 * view + 6]
        t = self.bundle.t[view]
        length = max(float(np.linalg.norm(t)), 1e-12)
        across = np.eye(3) - np.outer(t, t) / length**2
        turned, moved = block[:3, :3], across @ block[3:, 3:] @ across / length**2
        worst = [
            float(np.sqrt(max(np.linalg.eigvalsh(matrix)[-1], 0.0))) for matrix in (turned, moved)
        ]
        return float(np.degrees(worst[0])), float(np.degrees(worst[1]))


def adjust(
    bundle: Bundle, scale: float = 1.0, iterations: int = 50, tolerance: float = 1e-9
) -> Adjusted:
    """Find the cameras and points of maximum posterior probability.

    A point may pass infinity and then lies behind its cameras. This happens to distant points, and
    to all points if the parallax is below the noise; then the covariance is too small.

    Args:
        bundle: Initial values; no point may have depth 0 in a camera that observes it.
        scale: Scale of the Cauchy distribution of reprojection errors, pixels: about 1.7 times the
            standard deviation of the inliers.
        iterations: Largest number of steps.
        tolerance: Smallest relative decrease of the cost in a step after which the iteration
            continues.
    """
    order = np.argsort(bundle.point, kind="stable")
    bundle = replace(
        bundle, view=bundle.view[order], point=bundle.point[order], xy=bundle.xy[order]
    )
    q = homogeneous(bundle.points)
    projected = _project(bundle, q)
    layout = _Layout.of(bundle)
    cost = _cost(bundle, layout, projected.residuals, scale)
    normal = _normal(bundle, layout, q, projected, scale)
    damping, growth = 1e-4, 2.0
    for _ in range(iterations):
        step, moved = _step(bundle, layout, normal, damping)
        trial, trial_q = _moved(bundle, q, step, moved)
        trial_projected = _project(trial, trial_q)
        trial_cost = _cost(trial, layout, trial_projected.residuals, scale)
        if not trial_cost < cost:
            damping, growth = damping * growth, growth * 2
            if damping > 1e12:
                break
            continue
        gain = cost - trial_cost
        bundle, q, projected, cost = trial, trial_q, trial_projected, trial_cost
        normal = _normal(bundle, layout, q, projected, scale)
        damping, growth = max(damping / 5, 1e-12), 2.0
        if gain < tolerance * max(cost, 1e-300):
            break
    covariance = _covariance(bundle, layout, normal, projected.residuals, scale)
    residuals, view, point, xy = (
        np.empty_like(a) for a in (projected.residuals, bundle.view, bundle.point, bundle.xy)
    )
    residuals[order], view[order], point[order] = projected.residuals, bundle.view, bundle.point
    xy[order] = bundle.xy
    w = q[:, 3:]
    points = q[:, :3] / np.where(np.abs(w) > 1e-12, w, 1e-12)
    bundle = replace(bundle, points=points, view=view, point=point, xy=xy)
    return Adjusted(bundle, cost, residuals, covariance)


def homogeneous(points: np.ndarray) -> np.ndarray:
    """Return unit homogeneous coordinates [N, 4] of points [N, 3]."""
    q = np.concatenate([points, np.ones((len(points), 1))], 1)
    return q / np.linalg.norm(q, axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class _Projection:
    """Projected points of all observations, with the intermediate values for derivatives."""

    turned: np.ndarray  # [M, 3] rotated, not translated
    inverse_depth: np.ndarray  # [M]
    uv: np.ndarray  # [M, 2] on the plane at depth 1
    residuals: np.ndarray  # [M, 2] pixels


def _project(bundle: Bundle, q: np.ndarray) -> _Projection:
    at = q[bundle.point]
    turned = (bundle.R[bundle.view] @ at[:, :3, None])[..., 0]
    X = turned + at[:, 3:] * bundle.t[bundle.view]
    z = X[:, 2]
    inverse_depth = 1 / np.where(np.abs(z) > 1e-12, z, 1e-12)
    uv = X[:, :2] * inverse_depth[:, None]
    focals = bundle.focals[bundle.group[bundle.view]]
    residuals = uv * focals[:, None] + bundle.centers[bundle.view] - bundle.xy
    return _Projection(turned, inverse_depth, uv, residuals)


def _tangents(q: np.ndarray) -> np.ndarray:
    """Return three orthonormal tangent vectors [N, 4, 3] at each unit vector [N, 4].

    The products of a unit quaternion with i, j and k are orthogonal to it and to each other.
    """
    a, b, c, d = q.T
    rows = [[-b, -c, -d], [a, -d, c], [d, a, -b], [-c, b, a]]
    return np.array(rows).transpose(2, 0, 1)


def _derivatives(
    bundle: Bundle, q: np.ndarray, projected: _Projection
) -> tuple[np.ndarray, np.ndarray]:
    """Return derivatives of the residuals by camera [M, 2, 7] and by point [M, 2, 3]."""
    focals = bundle.focals[bundle.group[bundle.view]]
    by_X = np.empty((len(focals), 2, 3))
    by_X[:, :, :2] = (focals * projected.inverse_depth)[:, None, None] * np.eye(2)
    by_X[:, :, 2] = -(by_X[:, :, :2] @ projected.uv[:, :, None])[..., 0]
    at = q[bundle.point]
    camera = np.empty((len(focals), 2, _LOCAL))
    # A small rotation w moves a point X by w x X, so the derivative of r . X by w is X x r.
    camera[:, :, :3] = np.cross(projected.turned[:, None, :], by_X)
    camera[:, :, 3:6] = by_X * at[:, 3, None, None]
    camera[:, :, 6] = projected.uv * focals[:, None]
    pose = np.concatenate([bundle.R, bundle.t[:, :, None]], 2)
    point = by_X @ (pose[bundle.view] @ _tangents(q)[bundle.point])
    return camera, point


def _cost(bundle: Bundle, layout: _Layout, residuals: np.ndarray, scale: float) -> float:
    """Return minus twice the log posterior, up to a constant."""
    cost = 3 * np.log1p((residuals**2).sum(1) / scale**2).sum()
    cost += (layout.prior * _off_prior(bundle) ** 2).sum()
    if bundle.poses is not None:
        cost += (bundle.poses.pull(bundle.R, bundle.t)[0] ** 2).sum()
    return float(cost)


def _off_prior(bundle: Bundle) -> np.ndarray:
    """Return the offsets of the log focal lengths from the prior means: float64 [G]."""
    return np.log(bundle.focals / bundle.focal_prior)


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations: blocks of cameras and points, and minus half the gradient of the cost."""

    cameras: np.ndarray  # [P, P], without priors
    camera_side: np.ndarray  # [P], with priors
    points: np.ndarray  # [N, 3, 3]
    point_side: np.ndarray  # [N, 3]
    between: np.ndarray  # [M, 3, 7], point and camera of each observation
    prior: np.ndarray  # [P, P], cameras


def _normal(
    bundle: Bundle, layout: _Layout, q: np.ndarray, projected: _Projection, scale: float
) -> _Normal:
    camera, point = _derivatives(bundle, q, projected)
    weight = 3 / (scale**2 + (projected.residuals**2).sum(1))[:, None, None]
    weighted, minus = (weight * camera).transpose(0, 2, 1), -projected.residuals[:, :, None]
    of_points = (weight * point).transpose(0, 2, 1)
    V, G, M = len(bundle.R), len(bundle.focals), len(bundle.view)
    P = 6 * V + G
    blocks = (layout.by_view @ (weighted @ camera).reshape(M, -1)).reshape(V, _LOCAL, _LOCAL)
    H, side = np.zeros((P, P)), np.zeros(P)
    columns = layout.columns
    np.add.at(H, (columns[:, :, None], columns[:, None, :]), blocks)
    np.add.at(side, columns, layout.by_view @ (weighted @ minus)[..., 0])
    side[6 * V :] -= layout.prior * _off_prior(bundle)
    prior = np.diag(np.concatenate([np.zeros(6 * V), layout.prior]))
    if bundle.poses is not None:
        off, slopes = bundle.poses.pull(bundle.R, bundle.t)
        pose_columns = columns[:, :6]
        prior[pose_columns[:, :, None], pose_columns[:, None, :]] = (
            slopes.transpose(0, 2, 1) @ slopes
        )
        side[: 6 * V] -= (off[:, None] @ slopes).ravel()
    return _Normal(
        H,
        side,
        (layout.by_point @ (of_points @ point).reshape(M, -1)).reshape(-1, 3, 3),
        layout.by_point @ (of_points @ minus)[..., 0],
        of_points @ camera,
        prior,
    )


@dataclass(frozen=True, eq=False)
class _Layout:
    """Indices of the parameters, constant over the iterations.

    ``by_view``, ``by_point`` and ``by_lens`` [count, M] sum the rows of observations that share a
    view, a point, or a point and a lens.
    """

    columns: np.ndarray  # [V, 7] indices of the parameters of each view
    by_view: csr_array
    by_point: csr_array
    by_lens: csr_array
    prior: np.ndarray  # [G] prior weights of the log focal lengths
    free: np.ndarray  # [G] bool

    @staticmethod
    def of(bundle: Bundle) -> _Layout:
        V, N, G, M = len(bundle.R), len(bundle.points), len(bundle.focals), len(bundle.view)

        def sums(index: np.ndarray, count: int) -> csr_array:
            return csr_array((np.ones(M), (index, np.arange(M))), (count, M))

        pose = 6 * np.arange(V)[:, None] + np.arange(6)
        sigma, free = bundle.focal_sigma, bundle.focal_sigma > 0
        return _Layout(
            np.concatenate([pose, 6 * V + bundle.group[:, None]], 1),
            sums(bundle.view, V),
            sums(bundle.point, N),
            sums(bundle.point * G + bundle.group[bundle.view], N * G),
            np.where(free, 1 / np.where(free, sigma, 1) ** 2, 0.0),
            free,
        )


def _free(bundle: Bundle, layout: _Layout) -> np.ndarray:
    """Return an orthonormal basis [P, F] of the camera parameters without frame and scale."""
    V = len(bundle.R)
    every = np.eye(6 * V + len(layout.free))
    if bundle.poses is not None:
        return every[:, np.concatenate([np.ones(6 * V, bool), layout.free])]
    # t[1] moves orthogonally to itself.
    _, _, across = np.linalg.svd(bundle.t[1:2])
    second = every[:, 9:12] @ across[1:].T
    parts = [every[:, 6:9], second, every[:, 12 : 6 * V], every[:, 6 * V :][:, layout.free]]
    return np.concatenate(parts, 1)


def _reduced(
    bundle: Bundle, layout: _Layout, normal: _Normal, damping: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the cameras' Schur complement [P, P] and right side [P], and inverse point blocks."""
    diagonal = np.einsum("nii->ni", normal.points)
    damped = normal.points.copy()
    floor = 1e-14 * diagonal.sum(1, keepdims=True) + 1e-300
    np.einsum("nii->ni", damped)[:] += damping * diagonal + floor
    inverse = np.linalg.inv(damped)
    P, N = len(normal.cameras), len(bundle.points)
    S = normal.cameras.copy()
    side = normal.camera_side.copy()
    size = max(_CHUNK // (3 * P), 1)
    for start in range(0, N, size):
        stop = min(start + size, N)
        W = _wide(bundle, layout, normal.between, start, stop)
        flat = W.reshape(-1, P)
        S -= flat.T @ (inverse[start:stop] @ W).reshape(-1, P)
        solved = inverse[start:stop] @ normal.point_side[start:stop, :, None]
        side -= flat.T @ solved.ravel()
    return S, side, inverse


def _wide(
    bundle: Bundle, layout: _Layout, between: np.ndarray, start: int, stop: int
) -> np.ndarray:
    """Return the blocks [n, 3, P] between points ``start`` to ``stop`` and all cameras."""
    V, G = len(bundle.R), len(bundle.focals)
    mine = slice(*np.searchsorted(bundle.point, (start, stop)))
    point, view = bundle.point[mine] - start, bundle.view[mine]
    W = np.zeros((stop - start, 3, 6 * V + G))
    # A view observes a point once, but several views may share a lens, whose columns are summed.
    W[:, :, : 6 * V].reshape(stop - start, 3, V, 6)[point, :, view] = between[mine, :, :6]
    lens = layout.by_lens[start * G : stop * G] @ between[:, :, 6]
    W[:, :, 6 * V :] = lens.reshape(-1, G, 3).transpose(0, 2, 1)
    return W


def _step(
    bundle: Bundle, layout: _Layout, normal: _Normal, damping: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the damped step of the cameras [P] and of the points [N, 3] along their tangents."""
    S, side, inverse = _reduced(bundle, layout, normal, damping)
    S += normal.prior
    np.einsum("ii->i", S)[:] += damping * np.diag(normal.cameras + normal.prior)
    free = _free(bundle, layout)
    H = free.T @ S @ free
    norm = _unit(np.diag(H))
    H = H * norm[:, None] * norm + 1e-14 * np.eye(len(H))
    step = free @ (norm * np.linalg.solve(H, norm * (free.T @ side)))
    local = step[layout.columns][bundle.view]
    pulled = layout.by_point @ (normal.between @ local[..., None])[..., 0]
    moved = (inverse @ (normal.point_side - pulled)[..., None])[..., 0]
    return step, moved


def _unit(diagonal: np.ndarray) -> np.ndarray:
    """Return factors that scale a matrix with this diagonal to a unit diagonal."""
    return 1 / np.sqrt(np.maximum(diagonal, 1e-12 * max(float(diagonal.max()), 1e-100)))


def _moved(
    bundle: Bundle, q: np.ndarray, step: np.ndarray, moved: np.ndarray
) -> tuple[Bundle, np.ndarray]:
    V = len(bundle.R)
    poses = step[: 6 * V].reshape(V, 6)
    t = bundle.t + poses[:, 3:]
    if bundle.poses is None:
        t[1] *= np.linalg.norm(bundle.t[1]) / np.linalg.norm(t[1])
    logs = np.clip(step[6 * V :], -1, 1)  # bound the change of the lens in one step
    q = q + (_tangents(q) @ moved[..., None])[..., 0]
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return replace(
        bundle,
        R=_rotations(poses[:, :3]) @ bundle.R,
        t=t,
        focals=bundle.focals * np.exp(logs),
    ), q


def _rotations(vectors: np.ndarray) -> np.ndarray:
    """Return rotation matrices [V, 3, 3] of rotation vectors [V, 3], radians (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    cross = _cross_matrices(vectors)
    return (
        np.eye(3)
        + np.sinc(angle / np.pi) * cross
        + (np.sinc(angle / (2 * np.pi)) ** 2 / 2) * (cross @ cross)
    )


def _cross_matrices(vectors: np.ndarray) -> np.ndarray:
    """Return the cross-product matrices [V, 3, 3] of vectors [V, 3]."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)


def _covariance(
    bundle: Bundle, layout: _Layout, normal: _Normal, residuals: np.ndarray, scale: float
) -> np.ndarray:
    """Compute the covariance [P, P] of the cameras, with the noise level of the residuals.

    The covariance is that of an M-estimator (Huber 1981, ch. 7.6). Points and cameras reduce the
    degrees of freedom of the residuals.
    """
    S, _, _ = _reduced(bundle, layout, normal, 0.0)
    free = _free(bundle, layout)
    r2 = (residuals**2).sum(1)
    weight = 3 / (scale**2 + r2)
    count = 2 * len(r2)
    left = max(count - 3 * len(bundle.points) - free.shape[1], 1)
    slope = (weight**2 * scale**2 / 3).mean()
    noise = weight.mean() * (weight**2 * r2).sum() / left / slope**2
    H = free.T @ (S / max(noise, 1e-2)) @ free
    H += free.T @ normal.prior @ free
    norm = _unit(np.diag(H))
    values, vectors = np.linalg.eigh(H * norm[:, None] * norm)
    # Directions that no observation constrains get a large variance, not 0.
    inverse = (vectors / np.maximum(values, 1e-13)) @ vectors.T
    free = free * norm
    return free @ inverse @ free.T
