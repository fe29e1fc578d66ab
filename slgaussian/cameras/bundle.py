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
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

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
        moved = across @ block[3:, 3:] @ across / length**2
        largest = np.linalg.eigvalsh([block[:3, :3], moved])[:, -1]
        turned, shifted = np.degrees(np.sqrt(np.maximum(largest, 0))).tolist()
        return turned, shifted


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
    problem = _Problem(
        replace(
            bundle,
            points=homogeneous(bundle.points),
            view=bundle.view[order],
            point=bundle.point[order],
            xy=bundle.xy[order],
        ),
        scale,
    )
    state = problem.project(problem.start)
    normal = problem.normal(state)
    damping, growth = 1e-4, 2.0
    for _ in range(iterations):
        trial = problem.project(problem.take_step(state.bundle, normal, damping))
        gain = state.cost - trial.cost
        if not gain > 0:
            damping, growth = damping * growth, growth * 2
            if damping > 1e12:
                break
            continue
        state, normal = trial, problem.normal(trial)
        damping, growth = max(damping / 5, 1e-12), 2.0
        if gain < tolerance * max(state.cost, 1e-300):
            break
    residuals = np.empty_like(state.residuals)
    residuals[order] = state.residuals
    end, q = state.bundle, state.bundle.points
    points = q[:, :3] / np.where(np.abs(q[:, 3:]) > 1e-12, q[:, 3:], 1e-12)
    end = replace(bundle, R=end.R, t=end.t, focals=end.focals, points=points)
    return Adjusted(end, state.cost, residuals, problem.covariance(state, normal))


def homogeneous(points: np.ndarray) -> np.ndarray:
    """Return unit homogeneous coordinates [N, 4] of points [N, 3]."""
    q = np.concatenate([points, np.ones((len(points), 1))], 1)
    return q / np.linalg.norm(q, axis=1, keepdims=True)


class _State(NamedTuple):
    """Cameras and points, and the values of their projection."""

    bundle: Bundle
    turned: np.ndarray  # [M, 3] rotated, not translated
    inverse_depth: np.ndarray  # [M]
    uv: np.ndarray  # [M, 2] on the plane at depth 1
    residuals: np.ndarray  # [M, 2] pixels
    cost: float  # minus twice the log posterior, up to a constant


class _Normal(NamedTuple):
    """Normal equations: blocks of cameras and points, and minus half the gradient of the cost."""

    cameras: np.ndarray  # [P, P], without priors
    camera_side: np.ndarray  # [P], with priors
    points: np.ndarray  # [N, 3, 3]
    point_side: np.ndarray  # [N, 3]
    between: np.ndarray  # [M, 3, 7], point and camera of each observation
    prior: np.ndarray  # [P, P], cameras


class _Problem:
    """Least squares of a bundle of V views, N points and G focal lengths, with P = 6 V + G.

    The points of its bundles are unit homogeneous coordinates [N, 4], the observations sorted by
    point. ``by_view``, ``by_point`` and ``by_lens`` [count, M] sum the rows of observations that
    share a view, a point, or a point and a lens.
    """

    def __init__(self, start: Bundle, scale: float) -> None:
        V, N, G, M = len(start.R), len(start.points), len(start.focals), len(start.view)

        def sums(index: np.ndarray, count: int) -> csr_array:
            return csr_array((np.ones(M), (index, np.arange(M))), (count, M))

        self.start, self.scale = start, scale
        self.poses = 6 * V  # number of their parameters, which precede those of the lenses
        pose_columns = np.arange(self.poses).reshape(V, 6)
        self.columns = np.concatenate([pose_columns, self.poses + start.group[:, None]], 1)
        self.lens = start.group[start.view]
        self.by_view, self.by_point = sums(start.view, V), sums(start.point, N)
        self.by_lens = sums(start.point * G + self.lens, N * G)
        self.lens_free = start.focal_sigma > 0
        self.lens_prior = self.lens_free / np.where(self.lens_free, start.focal_sigma, 1) ** 2

    def project(self, bundle: Bundle) -> _State:
        at = bundle.points[bundle.point]
        turned = (bundle.R[bundle.view] @ at[:, :3, None])[..., 0]
        X = turned + at[:, 3:] * bundle.t[bundle.view]
        z = X[:, 2]
        inverse_depth = 1 / np.where(np.abs(z) > 1e-12, z, 1e-12)
        uv = X[:, :2] * inverse_depth[:, None]
        focals = bundle.focals[self.lens]
        residuals = uv * focals[:, None] + bundle.centers[bundle.view] - bundle.xy
        cost = 3 * np.log1p((residuals**2).sum(1) / self.scale**2).sum()
        cost += (self.lens_prior * _off_prior(bundle) ** 2).sum()
        if bundle.poses is not None:
            cost += (bundle.poses.pull(bundle.R, bundle.t)[0] ** 2).sum()
        return _State(bundle, turned, inverse_depth, uv, residuals, float(cost))

    def derivatives(self, state: _State) -> tuple[np.ndarray, np.ndarray]:
        """Return derivatives of the residuals by camera [M, 2, 7] and by point [M, 2, 3]."""
        bundle = state.bundle
        focals = bundle.focals[self.lens]
        by_X = np.empty((len(focals), 2, 3))
        by_X[:, :, :2] = (focals * state.inverse_depth)[:, None, None] * np.eye(2)
        by_X[:, :, 2] = -(by_X[:, :, :2] @ state.uv[:, :, None])[..., 0]
        camera = np.empty((len(focals), 2, 7))
        # A small rotation w moves a point X by w x X, so the derivative of r . X by w is X x r.
        camera[:, :, :3] = np.cross(state.turned[:, None, :], by_X)
        camera[:, :, 3:6] = by_X * bundle.points[bundle.point, 3, None, None]
        camera[:, :, 6] = state.uv * focals[:, None]
        pose = np.concatenate([bundle.R, bundle.t[:, :, None]], 2)
        return camera, by_X @ (pose[bundle.view] @ _tangents(bundle.points)[bundle.point])

    def normal(self, state: _State) -> _Normal:
        bundle, columns = state.bundle, self.columns
        camera, point = self.derivatives(state)
        weight = 3 / (self.scale**2 + (state.residuals**2).sum(1))[:, None, None]
        weighted, minus = (weight * camera).transpose(0, 2, 1), -state.residuals[:, :, None]
        of_points = (weight * point).transpose(0, 2, 1)
        P, M = self.poses + len(bundle.focals), len(bundle.view)
        H, side = np.zeros((P, P)), np.zeros(P)
        blocks = (self.by_view @ (weighted @ camera).reshape(M, 49)).reshape(-1, 7, 7)
        np.add.at(H, (columns[:, :, None], columns[:, None, :]), blocks)
        np.add.at(side, columns, self.by_view @ (weighted @ minus)[..., 0])
        side[self.poses :] -= self.lens_prior * _off_prior(bundle)
        prior = np.diag(np.concatenate([np.zeros(self.poses), self.lens_prior]))
        if bundle.poses is not None:
            residuals, slopes = bundle.poses.pull(bundle.R, bundle.t)
            poses = columns[:, :6]
            prior[poses[:, :, None], poses[:, None, :]] = slopes.transpose(0, 2, 1) @ slopes
            side[: self.poses] -= (residuals[:, None] @ slopes).ravel()
        return _Normal(
            H,
            side,
            (self.by_point @ (of_points @ point).reshape(M, 9)).reshape(-1, 3, 3),
            self.by_point @ (of_points @ minus)[..., 0],
            of_points @ camera,
            prior,
        )

    def take_step(self, bundle: Bundle, normal: _Normal, damping: float) -> Bundle:
        """Return the bundle after the damped step of the cameras and of the points.

        The normal equations [A W'; W B] [c; p] = [a; b] are solved for the cameras c by the Schur
        complement, (A - W' B^-1 W) c = a - W' B^-1 b, and then for the points, p = B^-1 (b - W c),
        where B has a block of 3 x 3 for each point.
        """
        S, side, inverse = self.eliminate_points(normal, damping)
        S += normal.prior
        np.einsum("ii->i", S)[:] += damping * np.diag(normal.cameras + normal.prior)
        free = self.free(bundle)
        H = free.T @ S @ free
        norm = _unit(np.diag(H))
        H = H * norm[:, None] * norm + 1e-14 * np.eye(len(H))
        step = free @ (norm * np.linalg.solve(H, norm * (free.T @ side)))
        local = step[self.columns][bundle.view]
        pulled = self.by_point @ (normal.between @ local[..., None])[..., 0]
        along = inverse @ (normal.point_side - pulled)[..., None]
        q = bundle.points + (_tangents(bundle.points) @ along)[..., 0]
        q /= np.linalg.norm(q, axis=1, keepdims=True)
        poses = step[: self.poses].reshape(-1, 6)
        t = bundle.t + poses[:, 3:]
        if bundle.poses is None:
            t[1] *= np.linalg.norm(bundle.t[1]) / np.linalg.norm(t[1])
        logs = np.clip(step[self.poses :], -1, 1)  # bound the change of the lens in one step
        focals = bundle.focals * np.exp(logs)
        return replace(bundle, R=_rotations(poses[:, :3]) @ bundle.R, t=t, focals=focals, points=q)

    def eliminate_points(
        self, normal: _Normal, damping: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return S = A - W' B^-1 W [P, P] and a - W' B^-1 b [P] of :meth:`take_step`, with damped
        B, and the blocks of B^-1 [N, 3, 3]."""
        diagonal = np.einsum("nii->ni", normal.points)
        damped = normal.points.copy()
        floor = 1e-14 * diagonal.sum(1, keepdims=True) + 1e-300
        np.einsum("nii->ni", damped)[:] += damping * diagonal + floor
        inverse = np.linalg.inv(damped)
        S, side = normal.cameras.copy(), normal.camera_side.copy()
        P, N, G = len(side), len(damped), len(self.lens_free)
        view, point = self.start.view, self.start.point
        size = max(_CHUNK // (3 * P), 1)
        for start in range(0, N, size):
            stop = min(start + size, N)
            block = slice(*np.searchsorted(point, (start, stop)))
            W = np.zeros((stop - start, 3, P))
            # A view observes a point once, but several views may share a lens: these are summed.
            poses = W[:, :, : self.poses].reshape(stop - start, 3, -1, 6)
            poses[point[block] - start, :, view[block]] = normal.between[block, :, :6]
            lens = self.by_lens[start * G : stop * G] @ normal.between[:, :, 6]
            W[:, :, self.poses :] = lens.reshape(-1, G, 3).transpose(0, 2, 1)
            flat = W.reshape(-1, P)
            S -= flat.T @ (inverse[start:stop] @ W).reshape(-1, P)
            side -= flat.T @ (inverse[start:stop] @ normal.point_side[start:stop, :, None]).ravel()
        return S, side, inverse

    def free(self, bundle: Bundle) -> np.ndarray:
        """Return an orthonormal basis [P, F] of the camera parameters without frame and scale."""
        identity = np.eye(self.poses + len(self.lens_free))
        lenses = identity[:, self.poses :][:, self.lens_free]
        if bundle.poses is not None:
            return np.concatenate([identity[:, : self.poses], lenses], 1)
        # t[1] moves orthogonally to itself.
        across = np.linalg.svd(bundle.t[1:2])[2][1:]
        second = identity[:, 9:12] @ across.T
        return np.concatenate([identity[:, 6:9], second, identity[:, 12 : self.poses], lenses], 1)

    def covariance(self, state: _State, normal: _Normal) -> np.ndarray:
        """Compute the covariance [P, P] of the cameras, with the noise level of the residuals.

        The covariance is that of an M-estimator (Huber 1981, ch. 7.6): for weights w of residuals
        r, the inverse of S times mean(w) sum(w^2 r^2) / (left slope^2), where ``slope`` is the mean
        derivative of the weighted residual. Points and cameras reduce the degrees of freedom
        ``left`` of the residuals.
        """
        S, _, _ = self.eliminate_points(normal, 0.0)
        free = self.free(state.bundle)
        r2 = (state.residuals**2).sum(1)
        weight = 3 / (self.scale**2 + r2)
        left = max(2 * len(r2) - 3 * len(normal.points) - free.shape[1], 1)
        slope = (weight**2 * self.scale**2 / 3).mean()
        noise = weight.mean() * (weight**2 * r2).sum() / left / slope**2
        H = free.T @ (S / max(noise, 1e-2)) @ free
        H += free.T @ normal.prior @ free
        norm = _unit(np.diag(H))
        values, vectors = np.linalg.eigh(H * norm[:, None] * norm)
        # Directions that no observation constrains get a large variance, not 0.
        inverse = (vectors / np.maximum(values, 1e-13)) @ vectors.T
        free = free * norm
        return free @ inverse @ free.T


def _tangents(q: np.ndarray) -> np.ndarray:
    """Return three orthonormal tangent vectors [N, 4, 3] at each unit vector [N, 4].

    The products of a unit quaternion with i, j and k are orthogonal to it and to each other.
    """
    a, b, c, d = q.T
    rows = [[-b, -c, -d], [a, -d, c], [d, a, -b], [-c, b, a]]
    return np.array(rows).transpose(2, 0, 1)


def _off_prior(bundle: Bundle) -> np.ndarray:
    """Return the offsets of the log focal lengths from the prior means: float64 [G]."""
    return np.log(bundle.focals / bundle.focal_prior)


def _unit(diagonal: np.ndarray) -> np.ndarray:
    """Return factors that scale a matrix with this diagonal to a unit diagonal."""
    return 1 / np.sqrt(np.maximum(diagonal, 1e-12 * max(float(diagonal.max()), 1e-100)))


def _rotations(vectors: np.ndarray) -> np.ndarray:
    """Return rotation matrices [V, 3, 3] of rotation vectors [V, 3], radians (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    cross = _cross_matrices(vectors)
    sine, cosine = np.sinc(angle / np.pi), np.sinc(angle / (2 * np.pi)) ** 2 / 2
    return np.eye(3) + sine * cross + cosine * (cross @ cross)


def _cross_matrices(vectors: np.ndarray) -> np.ndarray:
    """Return the cross-product matrices [V, 3, 3] of vectors [V, 3]."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
