"""Relative pose of two photographs from their matches, with known or unknown focal lengths.

PoseLib (Larsson, https://github.com/PoseLib/PoseLib) provides initial values: a calibrated pose
(five points, Nister 2004) at typical focal lengths, and, for one lens, a pose with its focal length
(six points, Kukelova et al. 2012). From each, pose and focal lengths are optimised together: the
robust Sampson distance of all matches in front of both cameras, plus the prior of the focal
lengths. The best optimum is returned; the curvature there gives its covariance.

Image coordinates here are pixels from the principal point.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import poselib

MAX_DISTANCE = 6.0
"""Distance to the epipolar line, pixels, from which on a match has no influence on the pose."""

CORRELATED_MATCHES = 3.0
"""Errors of matches are correlated (lens, shutter, moving objects): this many matches count as one
independent observation."""

SCALE_FACTOR, SCALE_FLOOR = 1.5, 0.2
"""The scale of the Cauchy loss is ``SCALE_FACTOR`` times the median distance of the inliers;
``SCALE_FLOOR``, pixels, is added in quadrature for errors of the model and the detector."""

INITIAL_SCALE = 0.6
"""Initial scale of the loss, pixels."""

FOCAL_STARTS = np.array(
    [(m - d / 2, m + d / 2) for m in (0.0, -1.5, 1.5) for d in (0.0, -1.5, 1.5)]
)
"""Initial focal lengths of two lenses, in standard deviations from the prior mean."""

LEAST_STRETCH = 0.1
"""Smallest magnification along the radius of a distortion that is modelled."""

BEND_STARTS = (0.0, -1.0, -2.0, 1.0)
"""Initial distortions, in standard deviations."""

RANSAC_OPTIONS = {
    "max_epipolar_error": 1.0, "success_prob": 0.999, "max_iterations": 1000,
    "min_iterations": 100, "seed": 0,
}  # fmt: skip
"""Options of PoseLib's estimators; the error is in pixels."""

MAX_FOCAL_DEVIATION = 4.0
"""Largest deviation of an initial focal length from the prior mean, in standard deviations."""

COARSE_MATCHES, FINE_STARTS = 400, 5
"""Every start is optimised on the first ``COARSE_MATCHES`` matches; the best ``FINE_STARTS``
results are optimised on all matches."""

MAX_MATCHES = 1200
"""Largest number of matches used, the most reliable first; half as many for initial values."""


@dataclass(frozen=True, eq=False)
class FocalPrior:
    """Prior of two lenses: focal lengths, and distortion around 0.

    Attributes:
        mean: float64 [2]. Logarithms of focal lengths in pixels.
        sigma: float64 [2]. Standard deviations of these; 0 for a given focal length.
        shared: Whether both views have one lens: the difference of the logarithms is then constant.
        bend: float64 [2]. Standard deviations of :attr:`TwoViews.bends`; 0 without distortion.
    """

    mean: np.ndarray
    sigma: np.ndarray
    shared: bool
    bend: np.ndarray = field(default_factory=lambda: np.zeros(2))

    @property
    def directions(self) -> np.ndarray:
        """Return the free directions of the two logarithms, in deviations: float64 [F, 2]."""
        return self._free(self.sigma)

    @property
    def bend_directions(self) -> np.ndarray:
        """Return the free directions of the two distortions, in deviations: float64 [B, 2]."""
        return self._free(self.bend)

    def _free(self, sigma: np.ndarray) -> np.ndarray:
        if self.shared:
            return np.full((int(sigma.max() > 0), 2), sigma.min())
        return np.diag(sigma)[sigma > 0]


@dataclass(frozen=True, eq=False)
class TwoViews:
    """Two cameras: ``X_b = R @ X_a + t``, t of length 1, focal lengths in pixels.

    ``moves`` are the offsets of the focal lengths, then of the distortions, from the prior mean in
    standard deviations, ``cost`` is the negative log posterior, ``scale`` the scale of the loss in
    pixels, and ``covariance`` [5 + F + B, 5 + F + B] that of rotation (radians), direction of t
    (radians) and moves. ``bends`` are the distortions, see :func:`straighten`.
    """

    R: np.ndarray
    t: np.ndarray
    focals: np.ndarray
    moves: np.ndarray
    cost: float = np.inf
    scale: float = INITIAL_SCALE
    covariance: np.ndarray | None = None
    bends: tuple[float, float] = (0.0, 0.0)

    def distance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Compute signed Sampson distances [M] in pixels of matches [M, 2] and [M, 2]."""
        (x, in_x), (y, in_y) = (straighten(*lens) for lens in zip((x, y), self.bends, strict=True))
        numerator, a, b = _sampson(self.fundamental(), x, y)
        return numerator / np.sqrt((in_y(a) ** 2).sum(1) + (in_x(b) ** 2).sum(1))

    def fundamental(self) -> np.ndarray:
        """Return F [3, 3] with ``(y, 1) @ F @ (x, 1) = 0``."""
        return _cross_matrix(self.t) @ self.R / self.pixels

    @property
    def pixels(self) -> np.ndarray:
        """Return the factors [3, 3] of F without and with focal lengths."""
        fa, fb = self.focals
        return np.outer([fb, fb, 1], [fa, fa, 1])

    def fundamental_slopes(self, prior: FocalPrior) -> np.ndarray:
        """Return derivatives [5 + F, 3, 3] of :meth:`fundamental` by :meth:`take_step`."""
        cross, F = _cross_matrix(self.t), self.fundamental()
        turned = [cross @ _cross_matrix(axis) @ self.R / self.pixels for axis in np.eye(3)]
        shifted = [_cross_matrix(axis) @ self.R / self.pixels for axis in _across(self.t)]
        in_a, in_b = np.array([-1.0, -1, 0]), np.array([[-1.0], [-1], [0]])
        zoomed = [F * (da * in_a + db * in_b) for da, db in prior.directions]
        return np.stack([*turned, *shifted, *zoomed])

    def rays(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return lines of sight [M, 3] and [M, 3] of matches in the axes of the second camera."""
        x, y = (straighten(*lens)[0] for lens in zip((x, y), self.bends, strict=True))
        return _homogeneous(x / self.focals[0]) @ self.R.T, _homogeneous(y / self.focals[1])

    def depths(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Compute z-depths [2, M] of matches in both cameras, in baselines; <= 0 if behind."""
        a, b = self.rays(x, y)
        normal = np.cross(a, b)
        numerators = [(np.cross(ray, self.t) * normal).sum(1) for ray in (b, a)]
        return np.stack(numerators) / np.maximum((normal**2).sum(1), 1e-18)

    def angles(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Compute the angle [M] between the two lines of sight, degrees."""
        a, b = self.rays(x, y)
        cross = np.linalg.norm(np.cross(a, b), axis=1)
        return np.degrees(np.arctan2(cross, (a * b).sum(1)))

    def inliers(self, x: np.ndarray, y: np.ndarray, within: float) -> np.ndarray:
        """Find matches in front of both cameras and ``within`` pixels of the epipolar lines."""
        return (np.abs(self.distance(x, y)) < within) & (self.depths(x, y) > 0).all(0)

    def take_step(self, step: np.ndarray, prior: FocalPrior) -> TwoViews:
        """Apply a step: rotation ``step[:3]``, direction of t ``step[3:5]``, lenses rest."""
        t = self.t + step[3:5] @ _across(self.t)
        moves = self.moves + step[5:]
        focals, bends = lenses(moves, prior)
        R = cv2.Rodrigues(step[:3])[0] @ self.R
        return replace(self, R=R, t=t / np.linalg.norm(t), focals=focals, moves=moves, bends=bends)

    def deviations(self, prior: FocalPrior) -> tuple[np.ndarray, np.ndarray]:
        """Return the standard deviations of log focal lengths [2] and of distortions [2]."""
        assert self.covariance is not None
        free, bent = prior.directions, prior.bend_directions
        split = 5 + len(free)
        focals, bends = self.covariance[5:split, 5:split], self.covariance[split:, split:]
        variances = (free.T @ focals @ free).diagonal(), (bent.T @ bends @ bent).diagonal()
        return np.sqrt(variances[0]), np.sqrt(variances[1])

    def turned_from(self, reference: TwoViews) -> float:
        """Compute the larger of the angles between rotations and between directions, degrees."""
        cosines = (np.trace(self.R @ reference.R.T) - 1) / 2, self.t @ reference.t
        return float(np.degrees(np.arccos(np.clip(cosines, -1, 1))).max())


def lenses(moves: np.ndarray, prior: FocalPrior) -> tuple[np.ndarray, tuple[float, float]]:
    """Return focal lengths [2], pixels, and distortions by their moves [F + B]."""
    free = prior.directions
    focals = np.exp(prior.mean + moves[: len(free)] @ free)
    first, second = (moves[len(free) :] @ prior.bend_directions).tolist()
    return focals, (first, second)


def straighten(
    points: np.ndarray, bend: float
) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Undistort points [M, 2], pixels from the principal point.

    A point at the radius u of the undistorted photograph is seen at ``u (1 + bend u^2)``: Brown's
    model with k1 = bend f^2.

    Returns:
        float64 [M, 2]: Undistorted points. A radius that no point reaches gives that of the fold.
        callable: Changes gradients [..., M, 2] by undistorted into those by observed points.
    """
    if not bend:
        return points, lambda gradients: gradients
    seen = np.sqrt((points**2).sum(1)) + 1e-12
    fold = np.sqrt((1 - LEAST_STRETCH) / max(-3 * bend, 1e-30))
    radius = np.minimum(seen, fold)
    for _ in range(8):  # Newton's method
        miss = radius * (1 + bend * radius**2) - seen
        radius = np.clip(radius - miss / (1 + 3 * bend * radius**2), 0, fold)
    along = points / seen[:, None]
    across = seen / radius
    radial = np.where(radius < fold, 1 + 3 * bend * radius**2, 1)

    def observe(gradients: np.ndarray) -> np.ndarray:
        inward = (gradients * along).sum(-1, keepdims=True) * along
        return gradients / across[:, None] + inward * (1 / radial - 1 / across)[:, None]

    return points * (radius / seen)[:, None], observe


def solve(x: np.ndarray, y: np.ndarray, prior: FocalPrior) -> list[TwoViews]:
    """Estimate relative poses from matches [M, 2] and [M, 2], most reliable first; best pose first.

    Poses within 3 degrees of a better one are omitted; the list may be empty.
    """
    x, y = x[:MAX_MATCHES], y[:MAX_MATCHES]
    if len(x) < 8:
        return []
    subset = x[:COARSE_MATCHES], y[:COARSE_MATCHES]
    rough = (_optimise(start, *subset, prior, 2) for start in _starts(x, y, prior))
    ends = _distinct_poses(_sorted_by_cost([end for end in rough if end is not None], *subset), 1.0)
    fine = (_optimise(end, x, y, prior, 3) for end in ends[:FINE_STARTS])
    ends = _distinct_poses(_sorted_by_cost([end for end in fine if end is not None], x, y), 3.0)
    return [_with_covariance(end, x, y, prior) for end in ends]


def _sorted_by_cost(ends: list[TwoViews], x: np.ndarray, y: np.ndarray) -> list[TwoViews]:
    """Recompute the costs with one scale of the loss, the smallest; sort by cost."""
    scale = min((end.scale for end in ends), default=INITIAL_SCALE)
    rated = [replace(end, cost=posterior(end, x, y, scale), scale=scale) for end in ends]
    return sorted(rated, key=lambda end: end.cost)


def _distinct_poses(ends: list[TwoViews], degrees: float) -> list[TwoViews]:
    """Drop poses within ``degrees`` of an earlier one."""
    distinct: list[TwoViews] = []
    for end in ends:
        if all(end.turned_from(better) > degrees for better in distinct):
            distinct.append(end)
    return distinct


def posterior(views: TwoViews, x: np.ndarray, y: np.ndarray, scale: float) -> float:
    """Compute the negative log posterior of two cameras, up to a constant.

    Matches behind a camera or farther off than ``MAX_DISTANCE`` cost as much as matches
    ``MAX_DISTANCE`` pixels off.
    """
    front = (views.depths(x, y) > 0).all(0)
    distance = np.where(front, np.minimum(np.abs(views.distance(x, y)), MAX_DISTANCE), MAX_DISTANCE)
    loss = 0.5 * np.log1p((distance / scale) ** 2).sum()
    return float(loss / CORRELATED_MATCHES + 0.5 * (views.moves**2).sum())


def evidence(views: TwoViews, x: np.ndarray, y: np.ndarray, scale: float) -> float:
    """Compute the log evidence of the assumptions on the lenses: the posterior integrated near its
    optimum, by Laplace's approximation, up to a constant."""
    assert views.covariance is not None
    x, y = x[:MAX_MATCHES], y[:MAX_MATCHES]
    return float(np.linalg.slogdet(views.covariance)[1] / 2) - posterior(views, x, y, scale)


def refine(views: TwoViews, x: np.ndarray, y: np.ndarray, prior: FocalPrior) -> TwoViews | None:
    """Optimise a solution under another prior; None if too few inliers remain."""
    x, y = x[:MAX_MATCHES], y[:MAX_MATCHES]
    end = _optimise(_under(views, prior), x, y, prior, 3)
    return None if end is None else _with_covariance(end, x, y, prior)


def widen(views: TwoViews, x: np.ndarray, y: np.ndarray, prior: FocalPrior) -> TwoViews:
    """Return a solution with its covariance under another prior, such as an unknown distortion."""
    views = _under(views, prior)
    return _with_covariance(views, x[:MAX_MATCHES], y[:MAX_MATCHES], prior)


def _under(views: TwoViews, prior: FocalPrior) -> TwoViews:
    """Express the lenses of a solution by the moves of another prior, as far as it permits."""
    moves = [
        np.linalg.lstsq(free.T, offset, rcond=None)[0]
        for free, offset in (
            (prior.directions, np.log(views.focals) - prior.mean),
            (prior.bend_directions, np.array(views.bends)),
        )
    ]
    return replace(views, moves=np.concatenate(moves)).take_step(
        np.zeros(5 + sum(map(len, moves))), prior
    )


def _starts(x: np.ndarray, y: np.ndarray, prior: FocalPrior) -> Iterator[TwoViews]:
    """Yield initial poses from the more reliable half of the matches [M, 2] and [M, 2]."""
    directions, count = prior.directions, len(prior.bend_directions)
    observed = [np.ascontiguousarray(points[: MAX_MATCHES // 2]) for points in (x, y)]
    for bend in BEND_STARTS if count else (0.0,):
        bent = np.full(count, bend)
        _, bends = lenses(np.concatenate([np.zeros(len(directions)), bent]), prior)
        x, y = (straighten(*lens)[0] for lens in zip(observed, bends, strict=True))
        for focal in FOCAL_STARTS if len(directions) == 2 else np.zeros((1, len(directions))):
            moves = np.concatenate([focal, bent])
            models = [
                {"model": "SIMPLE_PINHOLE", "params": [f, 0, 0]} for f in lenses(moves, prior)[0]
            ]
            pose, _ = poselib.estimate_relative_pose(x, y, *models, RANSAC_OPTIONS)
            yield from _two_views(pose, moves, prior)
        if len(directions) == 1:
            estimates, _ = poselib.estimate_shared_focal_relative_pose(
                x, y, np.zeros(2), RANSAC_OPTIONS
            )
            log_focal = np.log(max(estimates.camera1.params[0], 1.0))
            focal = np.clip(
                (log_focal - prior.mean[:1]) / directions[:, 0],
                -MAX_FOCAL_DEVIATION,
                MAX_FOCAL_DEVIATION,
            )
            yield from _two_views(estimates.pose, np.concatenate([focal, bent]), prior)


def _two_views(
    pose: poselib.CameraPose, moves: np.ndarray, prior: FocalPrior
) -> Iterator[TwoViews]:
    """Yield a pose of PoseLib, unless its translation is zero: PoseLib found no model."""
    length = np.linalg.norm(pose.t)
    if length > 0:
        focals, bends = lenses(moves, prior)
        yield TwoViews(np.array(pose.R), np.array(pose.t) / length, focals, moves, bends=bends)


def _optimise(
    start: TwoViews, x: np.ndarray, y: np.ndarray, prior: FocalPrior, rounds: int
) -> TwoViews | None:
    """Optimise the posterior from ``start``; None if too few inliers remain."""
    views = start
    for _ in range(rounds):
        inliers = views.inliers(x, y, MAX_DISTANCE)
        if inliers.sum() < 8:
            return None
        views = _minimise_cauchy(views, x[inliers], y[inliers], prior)
        distance = np.abs(views.distance(x[inliers], y[inliers]))
        near = distance[distance < MAX_DISTANCE / 2]
        if not len(near):
            return None
        noise = SCALE_FACTOR * float(np.median(near))
        views = replace(views, scale=float(np.clip(np.hypot(noise, SCALE_FLOOR), SCALE_FLOOR, 1.5)))
    return views


def _minimise_cauchy(views: TwoViews, x: np.ndarray, y: np.ndarray, prior: FocalPrior) -> TwoViews:
    """Minimise the Cauchy loss by reweighted Levenberg-Marquardt (Holland and Welsch 1977)."""

    def cost(views: TwoViews) -> float:
        loss = 0.5 * np.log1p((views.distance(x, y) / views.scale) ** 2).sum()
        return float(loss / CORRELATED_MATCHES + 0.5 * (views.moves**2).sum())

    damping, best = 1e-3, cost(views)
    for _ in range(15):
        hessian, gradient = _normal(views, x, y, prior)
        for _ in range(6):
            diagonal = np.diag(np.diag(hessian) * damping + 1e-12)
            trial = views.take_step(-np.linalg.solve(hessian + diagonal, gradient), prior)
            if (value := cost(trial)) < best:
                break
            damping *= 8
        else:
            break
        gain, views, best, damping = best - value, trial, value, max(damping / 10, 1e-9)
        if gain < 1e-5 * max(best, 1):
            break
    return views


def _normal(
    views: TwoViews, x: np.ndarray, y: np.ndarray, prior: FocalPrior
) -> tuple[np.ndarray, np.ndarray]:
    """Return the Hessian [P, P] and gradient [P] of the posterior of the given matches."""
    distance, J = (values / views.scale for values in linearise(views, x, y, prior))
    weight = 1 / (1 + distance**2) / CORRELATED_MATCHES
    hessian, gradient = (J * weight[:, None]).T @ J, J.T @ (weight * distance)
    hessian[5:, 5:] += np.eye(len(views.moves))
    gradient[5:] += views.moves
    return hessian, gradient


def linearise(
    views: TwoViews, x: np.ndarray, y: np.ndarray, prior: FocalPrior
) -> tuple[np.ndarray, np.ndarray]:
    """Return :meth:`TwoViews.distance` [M], and its derivatives [M, 5 + F + B] by the steps of
    :meth:`TwoViews.take_step`.

    With the numerator n = y F x and the squared gradient g = |Fx|^2 + |F'y|^2 over the first two
    components, the distance is d = n / sqrt(g), and a step changes it by
    dd = (dn - n / g (Fx dFx + F'y dF'y)) / sqrt(g).
    """
    columns = [
        (_bend(views, step).distance(x, y) - _bend(views, -step).distance(x, y)) / 0.02
        for step in 0.01 * prior.bend_directions
    ]
    (x, in_x), (y, in_y) = (straighten(*lens) for lens in zip((x, y), views.bends, strict=True))
    numerator, to_y, to_x = _sampson(views.fundamental(), x, y)
    to_y, to_x = in_y(to_y), in_x(to_x)
    square = (to_y**2).sum(1) + (to_x**2).sum(1)
    slopes, at_x, at_y = views.fundamental_slopes(prior), _homogeneous(x), _homogeneous(y)
    slopes_b = at_x @ slopes.transpose(0, 2, 1)
    slopes_a = at_y @ slopes[:, :, :2]
    slope = (to_y * in_y(slopes_b[..., :2])).sum(2) + (to_x * in_x(slopes_a)).sum(2)
    by_pose = ((at_y * slopes_b).sum(2) - numerator * slope / square) / np.sqrt(square)
    derivatives = np.concatenate([by_pose, columns]).T if columns else by_pose.T
    return numerator / np.sqrt(square), derivatives


def _bend(views: TwoViews, step: np.ndarray) -> TwoViews:
    """Add a step [2] to the distortions."""
    first, second = (views.bends + step).tolist()
    return replace(views, bends=(first, second))


def _with_covariance(views: TwoViews, x: np.ndarray, y: np.ndarray, prior: FocalPrior) -> TwoViews:
    inliers = views.inliers(x, y, MAX_DISTANCE)
    if inliers.sum() < 8:
        return replace(views, covariance=np.eye(5 + len(views.moves)))
    hessian, _ = _normal(views, x[inliers], y[inliers], prior)
    return replace(views, covariance=np.linalg.inv(hessian + 1e-9 * np.eye(len(hessian))))


def _sampson(
    F: np.ndarray, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the numerator [M] of the Sampson distance and its gradients [M, 2] and [M, 2]."""
    lines_b = x @ F[:, :2].T + F[:, 2]
    lines_a = y @ F[:2, :2] + F[2, :2]
    return (y * lines_b[:, :2]).sum(1) + lines_b[:, 2], lines_b[:, :2], lines_a


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Compute the cross product of two vectors [3]; ``np.cross`` is slow for single vectors."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _cross_matrix(v: np.ndarray) -> np.ndarray:
    """Return the cross-product matrix [3, 3] of a vector [3]."""
    x, y, z = v
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def _across(t: np.ndarray) -> np.ndarray:
    """Return two unit vectors [2, 3] orthogonal to a unit vector [3] and to each other."""
    side = np.zeros(3)
    side[np.abs(t).argmin()] = 1
    first = _cross(t, side)
    first /= np.sqrt(first @ first)
    return np.stack([first, _cross(t, first)])


def _homogeneous(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points, np.ones((len(points), 1))], 1)
