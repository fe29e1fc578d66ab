"""The relative pose of two photographs from their matches, with focal lengths known or not.

PoseLib (Larsson, https://github.com/PoseLib/PoseLib) draws the starting points: a calibrated pose
(five points, Nister 2004) at the usual focal lengths, and, of one lens, a pose with its focal
length (six points, Kukelova et al. 2012). From each, pose and focal lengths together descend on the
robust Sampson distance of all matches that lie in front of both cameras, plus what is usual of
focal lengths; the best end wins, and the curvature there says how sure it is.

Image coordinates here are pixels from the principal point.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
import poselib

from slgaussian.io import short_repr

FAR = 6.0
"""Pixels from its epipolar line from which on a match says nothing of a pose at all."""

COUPLING = 3.0
"""Matches err together, by the lens, the shutter and moving things: this many of them are worth one
that errs by itself."""

NOISE, FLOOR = 1.5, 0.2
"""The scale of Cauchy's loss is so many times the median distance of the inliers, and the floor,
pixels, is added in quadrature: what model and detector do not tell."""

START = 0.6
"""That scale at first."""

APART = np.array([(m - d / 2, m + d / 2) for m in (0.0, -1.5, 1.5) for d in (0.0, -1.5, 1.5)])
"""Focal lengths of two lenses to start from, deviations from what is usual."""

RANSAC = {
    "max_epipolar_error": 1.0, "success_prob": 0.999, "max_iterations": 1000,
    "min_iterations": 100, "seed": 0,
}  # fmt: skip
"""Options of PoseLib's estimators; the error is in pixels."""

ZOOMED = 6.0
"""Two photographs that should share a focal length do not, if so much of the posterior's logarithm
speaks for it: among pairs that do, at most 4 did."""

FARTHEST = 4.0
"""Deviations from what is usual up to which the focal length of a start is taken."""

ROUGHLY, FINELY = 400, 5
"""From every start the posterior of so many matches is descended; from so many of the best ends
that of all."""

MOST = 1200
"""Matches, the surest first, that are looked at; half as many for starting points."""


@dataclass(frozen=True, eq=False)
class FocalPrior:
    """Prior of two focal lengths.

    Attributes
    ----------
    mean : float64 [2]
        Logarithms of focal lengths in pixels.
    sigma : float64 [2]
        Deviations of these; 0 where a focal length is given.
    shared : bool
        Whether both are one lens: their logarithms keep their difference.
    """

    mean: np.ndarray
    sigma: np.ndarray
    shared: bool

    @property
    def directions(self) -> np.ndarray:
        """Directions in which the two logarithms may move, in deviations: float64 [F, 2]."""
        if self.shared:
            return np.full((int(self.sigma.max() > 0), 2), self.sigma.min())
        return np.diag(self.sigma)[self.sigma > 0]


@dataclass(frozen=True, eq=False)
class TwoViews:
    """Two cameras: ``X_b = R @ X_a + t``, t of length 1, focal lengths in pixels.

    ``moves`` holds how many deviations of the prior the focal lengths are off its mean, ``cost``
    the negative logarithm of the posterior, ``scale`` that of the loss, pixels, and ``covariance``
    [5 + F, 5 + F] that of turn (radians), direction (radians, across t) and moves.
    """

    R: np.ndarray
    t: np.ndarray
    focals: np.ndarray
    moves: np.ndarray
    cost: float = np.inf
    scale: float = START
    covariance: np.ndarray | None = None

    __repr__ = short_repr

    def distance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Sampson distances [M] in pixels of matches [M, 2] and [M, 2], signed."""
        numerator, a, b = _sampson(self.fundamental(), x, y)
        return numerator / np.sqrt((a**2).sum(1) + (b**2).sum(1))

    def fundamental(self) -> np.ndarray:
        """F [3, 3] with ``(y, 1) @ F @ (x, 1) = 0``."""
        fa, fb = self.focals
        return _cross_matrix(self.t) @ self.R / np.outer([fb, fb, 1], [fa, fa, 1])

    def fundamental_slopes(self, prior: FocalPrior) -> np.ndarray:
        """Derivatives [5 + F, 3, 3] of :meth:`fundamental` by the steps of :meth:`moved`."""
        F = self.fundamental()
        fa, fb = self.focals
        pixels = np.outer([fb, fb, 1], [fa, fa, 1])
        turned = [_cross_matrix(self.t) @ _cross_matrix(axis) @ self.R for axis in np.eye(3)]
        shifted = [_cross_matrix(axis) @ self.R for axis in _across(self.t)]
        in_a, in_b = np.array([-1.0, -1, 0]), np.array([[-1.0], [-1], [0]])
        zoomed = [F * (da * in_a + db * in_b) for da, db in prior.directions]
        return np.stack([*(slope / pixels for slope in (*turned, *shifted)), *zoomed])

    def depths(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """z-depths [2, M] of matches in either camera, baselines; not positive behind one."""
        a = _homogeneous(x / self.focals[0]) @ self.R.T
        b = _homogeneous(y / self.focals[1])
        normal = np.cross(a, b)
        square = np.maximum((normal**2).sum(1), 1e-18)
        return (
            np.stack([(np.cross(b, self.t) * normal).sum(1), (np.cross(a, self.t) * normal).sum(1)])
            / square
        )

    def angles(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Degrees [M] between the two lines of sight."""
        a = _homogeneous(x / self.focals[0]) @ self.R.T
        b = _homogeneous(y / self.focals[1])
        cross = np.linalg.norm(np.cross(a, b), axis=1)
        return np.degrees(np.arctan2(cross, (a * b).sum(1)))

    def inliers(self, x: np.ndarray, y: np.ndarray, within: float) -> np.ndarray:
        """Find matches in front of both cameras and ``within`` pixels of their lines, bool [M]."""
        return (np.abs(self.distance(x, y)) < within) & (self.depths(x, y) > 0).all(0)

    def moved(self, step: np.ndarray, prior: FocalPrior) -> TwoViews:
        """Turned by ``step[:3]``, t by ``step[3:5]`` across itself, focal lengths by the rest."""
        t = self.t + step[3:5] @ _across(self.t)
        moves = self.moves + step[5:]
        focals = np.exp(prior.mean + moves @ prior.directions)
        R = cv2.Rodrigues(step[:3])[0] @ self.R
        return replace(self, R=R, t=t / np.linalg.norm(t), focals=focals, moves=moves)

    def turned_from(self, reference: TwoViews) -> float:
        """Degrees between two answers: the larger of those of rotation and direction."""
        cosines = (np.trace(self.R @ reference.R.T) - 1) / 2, self.t @ reference.t
        return float(np.degrees(np.arccos(np.clip(cosines, -1, 1))).max())


def solve(x: np.ndarray, y: np.ndarray, prior: FocalPrior) -> tuple[list[TwoViews], FocalPrior]:
    """Relative poses that matches [M, 2] and [M, 2], surest first, speak for; the best first.

    Answers within 3 degrees of a better one are left out; there may be none. The prior that comes
    back is the one given, or that of two lenses where one does not explain the matches.
    """
    x, y = x[:MOST], y[:MOST]
    if len(x) < 8:
        return [], prior
    solutions = _solved(x, y, prior)
    separate = replace(prior, shared=False)
    if not prior.shared or not len(prior.directions):
        return solutions, prior
    if solutions and not _zoomed(solutions[0], x, y, separate):
        return solutions, prior
    alternatives = _solved(x, y, separate)
    if alternatives and (
        not solutions or _gain(solutions[0], alternatives[0], x, y, separate) > ZOOMED
    ):
        return alternatives, separate
    return solutions, prior


def _zoomed(views: TwoViews, x: np.ndarray, y: np.ndarray, separate: FocalPrior) -> bool:
    """Tell whether two focal lengths are worth a try where one was estimated."""
    if views.inliers(x, y, 3 * views.scale).mean() < 0.5:
        return True
    moves = np.repeat(views.moves, 2)
    alternative = _descended(replace(views, moves=moves), x, y, separate, 2)
    return alternative is not None and _gain(views, alternative, x, y, separate) > ZOOMED / 2


def _gain(
    shared: TwoViews, alternative: TwoViews, x: np.ndarray, y: np.ndarray, separate: FocalPrior
) -> float:
    return shared.cost - posterior(alternative, x, y, separate, shared.scale)


def _solved(x: np.ndarray, y: np.ndarray, prior: FocalPrior) -> list[TwoViews]:
    subset = x[:ROUGHLY], y[:ROUGHLY]
    rough = (_descended(start, *subset, prior, 2) for start in _starts(x, y, prior))
    ends = _rated([end for end in rough if end is not None], *subset, prior)
    fine = (_descended(end, x, y, prior, 3) for end in _unlike(ends, 1.0)[:FINELY])
    ends = _rated([end for end in fine if end is not None], x, y, prior)
    return [_with_covariance(end, x, y, prior) for end in _unlike(ends, 3.0)]


def _rated(ends: list[TwoViews], x: np.ndarray, y: np.ndarray, prior: FocalPrior) -> list[TwoViews]:
    """With their costs on one scale, that of the sharpest, the best first."""
    scale = min((end.scale for end in ends), default=START)
    rated = [replace(end, cost=posterior(end, x, y, prior, scale), scale=scale) for end in ends]
    return sorted(rated, key=lambda end: end.cost)


def _unlike(ends: list[TwoViews], degrees: float) -> list[TwoViews]:
    """Those that are not within so many degrees of one before them."""
    distinct: list[TwoViews] = []
    for end in ends:
        if all(end.turned_from(better) > degrees for better in distinct):
            distinct.append(end)
    return distinct


def posterior(
    views: TwoViews, x: np.ndarray, y: np.ndarray, prior: FocalPrior, scale: float
) -> float:
    """Negative logarithm of the posterior of two cameras, up to a constant.

    Matches that are far off, or behind a camera, cost what those ``FAR`` pixels off do.
    """
    distance = np.where(
        (views.depths(x, y) > 0).all(0), np.minimum(np.abs(views.distance(x, y)), FAR), FAR
    )
    loss = 0.5 * np.log1p((distance / scale) ** 2).sum()
    return float(loss / COUPLING + 0.5 * (views.moves**2).sum())


def _starts(x: np.ndarray, y: np.ndarray, prior: FocalPrior) -> Iterator[TwoViews]:
    """Yield poses to descend from, of the surest half of the matches [M, 2] and [M, 2]."""
    directions = prior.directions
    x, y = (np.ascontiguousarray(points[: MOST // 2]) for points in (x, y))
    for moves in APART if len(directions) == 2 else np.zeros((1, len(directions))):
        focals = np.exp(prior.mean + moves @ directions)
        lenses = [{"model": "SIMPLE_PINHOLE", "params": [f, 0, 0]} for f in focals]
        pose, _ = poselib.estimate_relative_pose(x, y, *lenses, RANSAC)
        yield from _two_views(pose, focals, moves)
    if len(directions) == 1:
        both, _ = poselib.estimate_shared_focal_relative_pose(x, y, np.zeros(2), RANSAC)
        log_focal = np.log(max(both.camera1.params[0], 1.0))
        moves = np.clip((log_focal - prior.mean[:1]) / directions[:, 0], -FARTHEST, FARTHEST)
        yield from _two_views(both.pose, np.exp(prior.mean + moves @ directions), moves)


def _two_views(
    pose: poselib.CameraPose, focals: np.ndarray, moves: np.ndarray
) -> Iterator[TwoViews]:
    """Yield a pose of PoseLib unless it is none: without a model its translation is zero."""
    length = np.linalg.norm(pose.t)
    if length > 0:
        yield TwoViews(np.array(pose.R), np.array(pose.t) / length, focals, moves)


def _descended(
    start: TwoViews, x: np.ndarray, y: np.ndarray, prior: FocalPrior, rounds: int
) -> TwoViews | None:
    """Descend the posterior from a start; None if it loses its matches on the way."""
    views = start
    for _ in range(rounds):
        inliers = views.inliers(x, y, FAR)
        if inliers.sum() < 8:
            return None
        views = _descent(views, x[inliers], y[inliers], prior)
        distance = np.abs(views.distance(x[inliers], y[inliers]))
        near = distance[distance < FAR / 2]
        if not len(near):
            return None
        noise = NOISE * float(np.median(near))
        views = replace(views, scale=float(np.clip(np.hypot(noise, FLOOR), FLOOR, 1.5)))
    return views


def _descent(views: TwoViews, x: np.ndarray, y: np.ndarray, prior: FocalPrior) -> TwoViews:
    """Levenberg and Marquardt's on Cauchy's loss, by weights (Holland and Welsch 1977)."""

    def cost(views: TwoViews) -> float:
        loss = 0.5 * np.log1p((views.distance(x, y) / views.scale) ** 2).sum()
        return float(loss / COUPLING + 0.5 * (views.moves**2).sum())

    damping, best = 1e-3, cost(views)
    for _ in range(15):
        hessian, gradient = _normal(views, x, y, prior)
        better = None
        for _ in range(6):
            diagonal = np.diag(np.diag(hessian) * damping + 1e-12)
            trial = views.moved(-np.linalg.solve(hessian + diagonal, gradient), prior)
            if (value := cost(trial)) < best:
                better = trial
                break
            damping *= 8
        if better is None:
            break
        gain, views, best, damping = best - value, better, value, max(damping / 10, 1e-9)
        if gain < 1e-5 * max(best, 1):
            break
    return views


def _normal(
    views: TwoViews, x: np.ndarray, y: np.ndarray, prior: FocalPrior
) -> tuple[np.ndarray, np.ndarray]:
    """Hessian [P, P] and gradient [P] of the posterior of matches that are all looked at."""
    J = jacobian(views, x, y, prior) / views.scale
    distance = views.distance(x, y) / views.scale
    weight = 1 / (1 + distance**2) / COUPLING
    hessian, gradient = (J * weight[:, None]).T @ J, J.T @ (weight * distance)
    hessian[5:, 5:] += np.eye(len(views.moves))
    gradient[5:] += views.moves
    return hessian, gradient


def jacobian(views: TwoViews, x: np.ndarray, y: np.ndarray, prior: FocalPrior) -> np.ndarray:
    """Derivatives [M, 5 + F] of :meth:`TwoViews.distance` by the steps of
    :meth:`TwoViews.moved`."""
    numerator, a, b = _sampson(views.fundamental(), x, y)
    square = (a**2).sum(1) + (b**2).sum(1)
    slopes = views.fundamental_slopes(prior)
    at_x, at_y = _homogeneous(x), _homogeneous(y)
    slopes_b = at_x @ slopes.transpose(0, 2, 1)
    slopes_a = at_y @ slopes[:, :, :2]
    slope = (a * slopes_b[..., :2]).sum(2) + (b * slopes_a).sum(2)
    columns = ((at_y * slopes_b).sum(2) - numerator * slope / square) / np.sqrt(square)
    return columns.T


def _with_covariance(views: TwoViews, x: np.ndarray, y: np.ndarray, prior: FocalPrior) -> TwoViews:
    inliers = views.inliers(x, y, FAR)
    if inliers.sum() < 8:
        return replace(views, covariance=np.eye(5 + len(views.moves)))
    hessian, _ = _normal(views, x[inliers], y[inliers], prior)
    return replace(views, covariance=np.linalg.inv(hessian + 1e-9 * np.eye(len(hessian))))


def _sampson(
    F: np.ndarray, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Numerator [M] and the two halves of the denominator's gradient [M, 2] and [M, 2]."""
    lines_b = x @ F[:, :2].T + F[:, 2]
    lines_a = y @ F[:2, :2] + F[2, :2]
    return (y * lines_b[:, :2]).sum(1) + lines_b[:, 2], lines_b[:, :2], lines_a


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Of two vectors; NumPy's is slow on single ones."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _cross_matrix(v: np.ndarray) -> np.ndarray:
    """Return the matrix [3, 3] that multiplies by ``v`` [3] as its cross product does."""
    x, y, z = v
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def _across(t: np.ndarray) -> np.ndarray:
    """Return two unit vectors [2, 3] at right angles to a unit vector [3] and each other."""
    side = np.zeros(3)
    side[np.abs(t).argmin()] = 1
    first = _cross(t, side)
    first /= np.sqrt(first @ first)
    return np.stack([first, _cross(t, first)])


def _homogeneous(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points, np.ones((len(points), 1))], 1)
