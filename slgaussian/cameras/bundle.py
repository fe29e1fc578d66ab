"""Robust bundle adjustment: cameras and points moved until the points land where they were seen.

Levenberg-Marquardt on the Schur complement over the points (Triggs et al. 1999, "Bundle adjustment:
a modern synthesis"), in float64. Points move on the unit sphere of homogeneous coordinates, so that
those near infinity behave as well as any other. An observation is a sample of a two-dimensional
Cauchy distribution: gross outliers count for almost nothing, and priors weigh against it as they
should.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from slgaussian.io import short_repr

_LOCAL = 8
"""Parameters of a camera that one observation depends on: rotation, t, log focal length, k1."""

_CHUNK = 1 << 21
"""Numbers of the dense blocks between points and cameras that are held at once."""


@dataclass(frozen=True, eq=False)
class PosePrior:
    """Prior of camera poses; it fixes the frame and the scale.

    Attributes
    ----------
    R, centers : float64 [V, 3, 3], [V, 3]
        World to camera, and where each stands.
    turn : float
        Standard deviation of each rotation about each axis, radians.
    move : float64 [V]
        Standard deviation of each centre along each axis, scene units.
    """

    R: np.ndarray
    centers: np.ndarray
    turn: float
    move: np.ndarray

    __repr__ = short_repr

    def pull(self, R: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return distances of poses in standard deviations [V, 6], and derivatives [V, 6, 6]."""
        back = R.transpose(0, 2, 1)
        turned = Rotation.from_matrix(R @ self.R.transpose(0, 2, 1)).as_rotvec()
        moved = -(back @ t[:, :, None])[..., 0] - self.centers
        slopes = np.zeros((len(R), 6, 6))
        slopes[:, :3, :3] = np.eye(3) / self.turn
        # The rotation turns the world about the camera's origin, and t goes with it.
        slopes[:, 3:, :3] = -back @ _cross_matrices(t) / self.move[:, None, None]
        slopes[:, 3:, 3:] = -back / self.move[:, None, None]
        return np.concatenate([turned / self.turn, moved / self.move[:, None]], 1), slopes


@dataclass(frozen=True, eq=False)
class Bundle:
    """Cameras, points and where the points were seen.

    Without a prior of the poses the world is the first camera: its pose is the identity.

    Attributes
    ----------
    R, t : float64 [V, 3, 3], [V, 3]
        World to camera, OpenCV axes. Without a prior of the poses ``t[1]`` keeps its length, which
        fixes the scale.
    centers : float64 [V, 2]
        Principal points, pixels; kept.
    group : int64 [V]
        Which focal length and k1 each view has.
    focals, k1 : float64 [G]
        Pixels; first radial distortion (OpenCV's).
    points : float64 [N, 3]
    view, point : int64 [M]
        Of each observation; no two of the same view and point.
    xy : float64 [M, 2]
        Observed pixels.
    focal_prior, focal_sigma : float64 [G]
        Normal prior of the logarithm of each focal length: its centre is given in pixels; a
        standard deviation of 0 keeps the focal length, one of infinity leaves it free.
    k1_sigma : float
        Standard deviation of the prior of each k1, about 0; 0 keeps k1.
    poses : PosePrior, optional
    """

    R: np.ndarray
    t: np.ndarray
    centers: np.ndarray
    group: np.ndarray
    focals: np.ndarray
    k1: np.ndarray
    points: np.ndarray
    view: np.ndarray
    point: np.ndarray
    xy: np.ndarray
    focal_prior: np.ndarray
    focal_sigma: np.ndarray
    k1_sigma: float = 0.0
    poses: PosePrior | None = None

    __repr__ = short_repr

    def residuals(self) -> np.ndarray:
        """Return projected minus observed positions, pixels: float64 [M, 2]."""
        return _project(self, homogeneous(self.points)).residuals

    def depths(self) -> np.ndarray:
        """Depth of each observed point in the camera that sees it: float64 [M]."""
        world = self.points[self.point]
        return np.einsum("mj,mj->m", self.R[self.view, 2], world) + self.t[self.view, 2]


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Result of :func:`adjust`.

    Attributes
    ----------
    bundle : Bundle
    cost : float
        Minus twice the logarithm of the posterior, less a constant.
    residuals : float64 [M, 2]
        Pixels.
    covariance : float64 [6 V + 2 G, 6 V + 2 G]
        Of all cameras, given the noise that the residuals show: for each view a rotation (a vector
        in camera axes, applied after ``R``) and ``t``, then the logarithm of each focal length,
        then each k1. What was kept has none.
    """

    bundle: Bundle
    cost: float
    residuals: np.ndarray
    covariance: np.ndarray

    __repr__ = short_repr

    @cached_property
    def focal_deviations(self) -> np.ndarray:
        """Standard deviation of the logarithm of each focal length: float64 [G]."""
        start = 6 * len(self.bundle.R)
        return np.sqrt(np.diag(self.covariance)[start : start + len(self.bundle.focals)])

    def degrees(self, view: int) -> tuple[float, float]:
        """Standard deviations of a view's rotation and direction of ``t``, degrees, along the worst
        axis, against the first view."""
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
    """Move cameras and points to where the observations are most likely.

    Parameters
    ----------
    bundle : Bundle
        The start; points that lie on a camera's own plane must have been dropped.
    scale : float
        Of the Cauchy distribution of observations about their points, pixels: about 1.7 times the
        standard deviation of good ones.
    iterations : int
        Steps tried at most.
    tolerance : float
        Part of the cost by which a step must lower it to be followed by another.

    Notes
    -----
    A point may pass infinity and then lies behind its cameras (:meth:`Bundle.depths`): one that is
    far away, or all of them where the parallax drowns in noise, in which case the covariance is too
    small.
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
        trial_seen = _project(trial, trial_q)
        trial_cost = _cost(trial, layout, trial_seen.residuals, scale)
        if not trial_cost < cost:
            damping, growth = damping * growth, growth * 2
            if damping > 1e12:
                break
            continue
        gain = cost - trial_cost
        bundle, q, projected, cost = trial, trial_q, trial_seen, trial_cost
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
    """Unit homogeneous coordinates [N, 4] of points [N, 3]."""
    q = np.concatenate([points, np.ones((len(points), 1))], 1)
    return q / np.linalg.norm(q, axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class _Seen:
    """Projected points of all observations, and what their derivatives are made of."""

    turned: np.ndarray  # [M, 3] rotated, not yet moved
    inverse_depth: np.ndarray  # [M]
    uv: np.ndarray  # [M, 2] on the plane at depth 1
    residuals: np.ndarray  # [M, 2] pixels


def _project(bundle: Bundle, q: np.ndarray) -> _Seen:
    at = q[bundle.point]
    turned = (bundle.R[bundle.view] @ at[:, :3, None])[..., 0]
    X = turned + at[:, 3:] * bundle.t[bundle.view]
    z = X[:, 2]
    inverse_depth = 1 / np.where(np.abs(z) > 1e-12, z, 1e-12)
    uv = X[:, :2] * inverse_depth[:, None]
    lens = bundle.group[bundle.view]
    stretch = bundle.focals[lens] * (1 + bundle.k1[lens] * (uv**2).sum(1))
    residuals = uv * stretch[:, None] + bundle.centers[bundle.view] - bundle.xy
    return _Seen(turned, inverse_depth, uv, residuals)


def _tangents(q: np.ndarray) -> np.ndarray:
    """Three orthogonal unit vectors [N, 4, 3] across each unit vector [N, 4].

    The products of a quaternion with i, j and k are across it, and across one another.
    """
    a, b, c, d = q.T
    rows = [[-b, -c, -d], [a, -d, c], [d, a, -b], [-c, b, a]]
    return np.array(rows).transpose(2, 0, 1)


def _derivatives(bundle: Bundle, q: np.ndarray, projected: _Seen) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the residuals by the camera [M, 2, 8] and by the point [M, 2, 3]."""
    lens = bundle.group[bundle.view]
    f, k1 = bundle.focals[lens], bundle.k1[lens]
    u, v = projected.uv.T
    r2 = u**2 + v**2
    by_uv = (f * (1 + k1 * r2))[:, None, None] * np.eye(2)
    by_uv += (2 * f * k1)[:, None, None] * (projected.uv[:, :, None] * projected.uv[:, None, :])
    by_X = np.empty((len(u), 2, 3))
    by_X[:, :, :2] = by_uv * projected.inverse_depth[:, None, None]
    by_X[:, :, 2] = -(by_X[:, :, :2] @ projected.uv[:, :, None])[..., 0]
    at = q[bundle.point]
    camera = np.empty((len(u), 2, _LOCAL))
    # A small rotation w moves a point X by w x X, so a row r of by_X answers with X x r.
    camera[:, :, :3] = np.cross(projected.turned[:, None, :], by_X)
    camera[:, :, 3:6] = by_X * at[:, 3, None, None]
    camera[:, :, 6] = projected.uv * (f * (1 + k1 * r2))[:, None]
    camera[:, :, 7] = projected.uv * (f * r2)[:, None]
    pose = np.concatenate([bundle.R, bundle.t[:, :, None]], 2)
    point = by_X @ (pose[bundle.view] @ _tangents(q)[bundle.point])
    return camera, point


def _cost(bundle: Bundle, layout: _Layout, residuals: np.ndarray, scale: float) -> float:
    """Minus twice the logarithm of the posterior, less a constant."""
    cost = 3 * np.log1p((residuals**2).sum(1) / scale**2).sum()
    cost += (layout.prior * _off_prior(bundle) ** 2).sum()
    if bundle.poses is not None:
        cost += (bundle.poses.pull(bundle.R, bundle.t)[0] ** 2).sum()
    return float(cost)


def _off_prior(bundle: Bundle) -> np.ndarray:
    """Distance of log focals and k1 from the centres of their priors: float64 [2 G]."""
    return np.concatenate([np.log(bundle.focals / bundle.focal_prior), bundle.k1])


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations: blocks of cameras and points, and minus half the cost's gradient."""

    cameras: np.ndarray  # [P, P], without priors
    camera_side: np.ndarray  # [P], with priors
    points: np.ndarray  # [N, 3, 3]
    point_side: np.ndarray  # [N, 3]
    between: np.ndarray  # [M, 3, 8] of each observation's point and camera
    prior: np.ndarray  # [P, P] of the cameras


def _normal(
    bundle: Bundle, layout: _Layout, q: np.ndarray, projected: _Seen, scale: float
) -> _Normal:
    camera, point = _derivatives(bundle, q, projected)
    weight = 3 / (scale**2 + (projected.residuals**2).sum(1))[:, None, None]
    weighted, minus = (weight * camera).transpose(0, 2, 1), -projected.residuals[:, :, None]
    of_points = (weight * point).transpose(0, 2, 1)
    V, G, M = len(bundle.R), len(bundle.focals), len(bundle.view)
    P = 6 * V + 2 * G
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
    """Indices of the parameters; the same in every step.

    ``by_view``, ``by_point`` and ``by_lens`` [count, M] sum the rows of observations that share a
    view, a point, or a point and a lens.
    """

    columns: np.ndarray  # [V, 8] of the parameters of each view among all
    by_view: csr_array
    by_point: csr_array
    by_lens: csr_array
    prior: np.ndarray  # [2 G] weights of the priors of log focals and k1
    free: np.ndarray  # [2 G] bool

    @staticmethod
    def of(bundle: Bundle) -> _Layout:
        V, N, G, M = len(bundle.R), len(bundle.points), len(bundle.focals), len(bundle.view)

        def sums(index: np.ndarray, count: int) -> csr_array:
            return csr_array((np.ones(M), (index, np.arange(M))), (count, M))

        pose = 6 * np.arange(V)[:, None] + np.arange(6)
        lens = 6 * V + bundle.group[:, None] + G * np.arange(2)
        sigma = np.concatenate([bundle.focal_sigma, np.full(G, bundle.k1_sigma)])
        free = sigma > 0
        return _Layout(
            np.concatenate([pose, lens], 1),
            sums(bundle.view, V),
            sums(bundle.point, N),
            sums(bundle.point * G + bundle.group[bundle.view], N * G),
            np.where(free, 1 / np.where(free, sigma, 1) ** 2, 0.0),
            free,
        )


def _free(bundle: Bundle, layout: _Layout) -> np.ndarray:
    """Orthogonal directions [P, F] in which the cameras may move: neither frame nor scale."""
    V = len(bundle.R)
    every = np.eye(6 * V + len(layout.free))
    if bundle.poses is not None:
        return every[:, np.concatenate([np.ones(6 * V, bool), layout.free])]
    # t[1] moves across itself.
    _, _, across = np.linalg.svd(bundle.t[1:2])
    second = every[:, 9:12] @ across[1:].T
    parts = [every[:, 6:9], second, every[:, 12 : 6 * V], every[:, 6 * V :][:, layout.free]]
    return np.concatenate(parts, 1)


def _reduced(
    bundle: Bundle, layout: _Layout, normal: _Normal, damping: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Schur complement [P, P] and right side [P] of the cameras, and inverse blocks of points."""
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
    """Blocks [n, 3, P] of the points from ``start`` to ``stop`` with all cameras."""
    V, G = len(bundle.R), len(bundle.focals)
    mine = slice(*np.searchsorted(bundle.point, (start, stop)))
    point, view = bundle.point[mine] - start, bundle.view[mine]
    W = np.zeros((stop - start, 3, 6 * V + 2 * G))
    # Each view sees a point once, but several may share a lens, whose columns add up.
    W[:, :, : 6 * V].reshape(stop - start, 3, V, 6)[point, :, view] = between[mine, :, :6]
    lens = layout.by_lens[start * G : stop * G] @ between[:, :, 6:].reshape(-1, 6)
    W[:, :, 6 * V :] = lens.reshape(-1, G, 3, 2).transpose(0, 2, 3, 1).reshape(-1, 3, 2 * G)
    return W


def _step(
    bundle: Bundle, layout: _Layout, normal: _Normal, damping: float
) -> tuple[np.ndarray, np.ndarray]:
    """The damped step: of the cameras [P], and of the points [N, 3] along their tangents."""
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
    """Factors that bring a matrix with this diagonal to ones."""
    return 1 / np.sqrt(np.maximum(diagonal, 1e-12 * max(float(diagonal.max()), 1e-100)))


def _moved(
    bundle: Bundle, q: np.ndarray, step: np.ndarray, moved: np.ndarray
) -> tuple[Bundle, np.ndarray]:
    V, G = len(bundle.R), len(bundle.focals)
    poses = step[: 6 * V].reshape(V, 6)
    t = bundle.t + poses[:, 3:]
    if bundle.poses is None:
        t[1] *= np.linalg.norm(bundle.t[1]) / np.linalg.norm(t[1])
    logs = np.clip(step[6 * V : 6 * V + G], -1, 1)  # no step may run away to an absurd lens
    q = q + (_tangents(q) @ moved[..., None])[..., 0]
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return replace(
        bundle,
        R=_rotations(poses[:, :3]) @ bundle.R,
        t=t,
        focals=bundle.focals * np.exp(logs),
        k1=bundle.k1 + step[6 * V + G :],
    ), q


def _rotations(vectors: np.ndarray) -> np.ndarray:
    """Rotations [V, 3, 3] about vectors [V, 3] by their length, radians (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    cross = _cross_matrices(vectors)
    return (
        np.eye(3)
        + np.sinc(angle / np.pi) * cross
        + (np.sinc(angle / (2 * np.pi)) ** 2 / 2) * (cross @ cross)
    )


def _cross_matrices(vectors: np.ndarray) -> np.ndarray:
    """Matrices [V, 3, 3] that multiply as the cross product with vectors [V, 3] does."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)


def _covariance(
    bundle: Bundle, layout: _Layout, normal: _Normal, residuals: np.ndarray, scale: float
) -> np.ndarray:
    """Covariance [P, P] of the cameras, with the noise that the residuals show.

    An M-estimator's (Huber 1981, ch. 7.6), whose residuals stand for as many observations as are
    left when the points and cameras have taken theirs.
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
    # What no observation says anything of is very uncertain, not certain.
    inverse = (vectors / np.maximum(values, 1e-13)) @ vectors.T
    free = free * norm
    return free @ inverse @ free.T
