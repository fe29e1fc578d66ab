"""Incremental structure from motion of three or more photographs, from solved pairs.

Matches of the pairs are joined into tracks. The initial pair has the most and widest inliers. Every
other view is placed by its triangulated points (perspective-n-point in OpenCV's RANSAC, and the
relative poses of its pairs), followed by bundle adjustment, as in Snavely et al. 2006, "Photo
tourism", and COLMAP (Schonberger and Frahm 2016).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from slgaussian.cameras.bundle import Adjusted, Bundle, adjust
from slgaussian.cameras.epipolar import TwoViews
from slgaussian.cameras.tracks import (
    Tracks,
    join_tracks,
    triangulate_inliers,
    triangulation_angles,
)

MAX_REPROJECTION_ERROR = 3.0
"""Largest reprojection error of an inlier, pixels."""

UNADJUSTED_ERROR_FACTOR = 3.0
"""Factor of ``MAX_REPROJECTION_ERROR`` before the focal length has been adjusted to the view."""

MIN_INLIERS, MIN_INLIER_SHARE = 12, 0.25
"""Smallest number of inliers, and fraction of the view's observations, to place a view."""

TRUSTED_CONFIDENCE, MIN_SCALE_POINTS = 0.5, 5
"""With a pose from a pair of this confidence, this many points suffice for the scale."""

ATTEMPTS = ((MIN_INLIERS, 1.5), (MIN_INLIERS, 0.4), (MIN_SCALE_POINTS, 0.4))
"""Smallest numbers of inliers, and of degrees of the triangulation angle of points, by which views
are placed: each is used if no more views can be placed with those before."""

MAX_INITIAL_PAIRS, SUFFICIENT_INLIER_SHARE = 4, 0.9
"""Largest number of initial pairs tried, and fraction of inlier observations that, with all views
placed, ends the search."""

INTERMEDIATE_TRACKS, FINAL_TRACKS = 250, 1000
"""Tracks per view in an intermediate and in the final bundle adjustment, the longest first."""


@dataclass(frozen=True, eq=False)
class Tie:
    """Matches and relative pose of two views.

    Attributes:
        views: (int, int)
        features: (int64 [M], int64 [M]). Indices of matching features that are inliers of the
            relative pose, in each view.
        relative: Relative pose, t up to scale, and focal lengths; None if unknown.
        angle: Degrees between the two lines of sight, median.
        confidence: Probability, 0 to 1, that the relative pose is right; matches are used
            regardless.
    """

    views: tuple[int, int]
    features: tuple[np.ndarray, np.ndarray]
    relative: TwoViews | None
    angle: float
    confidence: float


@dataclass(frozen=True, eq=False)
class Placed:
    """Views in one world frame.

    Attributes:
        order: int64 [P]. Indices of the placed views, in the order of the views of ``adjusted``.
        adjusted: The world is the frame of the first view in ``order``; the first two are at
            distance 1.
    """

    order: np.ndarray
    adjusted: Adjusted


def place(
    keypoints: Sequence[np.ndarray],
    centers: np.ndarray,
    group: np.ndarray,
    focal_prior: np.ndarray,
    focal_sigma: np.ndarray,
    ties: Sequence[Tie],
) -> Placed | None:
    """Place as many views as possible.

    Args:
        keypoints: sequence of float64 [n, 2]. Pixels of each view's features.
        centers: float64 [V, 2]. Principal points.
        group: int64 [V]. Index of the focal length of each view.
        focal_prior, focal_sigma: float64 [G]. As in :class:`slgaussian.cameras.bundle.Bundle`.
        ties: sequence of Tie. Each from a view of smaller to a view of larger index; in any order.

    Returns:
        Placed or None: The first view has the smallest index, the second is farthest from it; None
            if no initial pair can be reconstructed.
    """
    if not ties:
        return None
    ties = sorted(ties, key=lambda tie: tie.views)
    tracks = join_tracks(keypoints, [(*tie.views, *tie.features) for tie in ties])
    ends = np.array([tie.views for tie in ties]).T
    tied = coo_array((np.ones(len(ties)), tuple(ends)), shape=(len(keypoints),) * 2)
    _, piece = connected_components(tied, directed=False)
    reachable = np.bincount(piece)[piece]  # number of views connected to each by ties

    def worth(tie: Tie) -> tuple[int, float]:
        width = min(tie.angle, 8.0) ** 0.5
        return reachable[tie.views[0]], len(tie.features[0]) * width * (0.1 + tie.confidence)

    starts = sorted((tie for tie in ties if tie.relative is not None), key=worth, reverse=True)
    trials: list[tuple[tuple[int, int], _Reconstruction]] = []
    for start in starts[:MAX_INITIAL_PAIRS]:
        grown = _Reconstruction(tracks, centers, group, focal_prior, focal_sigma, ties)
        if not grown.grow(start):
            continue
        explained = grown.count_inliers()
        trials.append(((len(grown.placed), explained), grown))
        sufficient = SUFFICIENT_INLIER_SHARE * len(tracks.view)
        if len(grown.placed) == len(keypoints) and explained > sufficient:
            break
    return max(trials, key=lambda trial: trial[0])[1].finish() if trials else None


@dataclass(eq=False)
class _Reconstruction:
    """Views placed so far; the world is the frame of the initial pair's first view."""

    tracks: Tracks
    centers: np.ndarray
    group: np.ndarray
    focal_prior: np.ndarray
    focal_sigma: np.ndarray
    ties: Sequence[Tie]
    placed: list[int] = field(default_factory=list)
    placed_lenses: set[int] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.R = np.tile(np.eye(3), (len(self.centers), 1, 1))
        self.t = np.zeros((len(self.centers), 3))
        self.focals = self.focal_prior.copy()

    def grow(self, start: Tie) -> bool:
        """Place as many views as possible; return False if the initial pair cannot be placed."""
        relative, (a, b) = start.relative, start.views
        assert relative is not None
        for view, focal in zip(start.views, relative.focals, strict=True):
            lens = int(self.group[view])
            if lens not in self.placed_lenses and self.focal_sigma[lens] > 0:
                self.focals[lens] = focal
            self.placed_lenses.add(lens)
        self.R[b], self.t[b] = relative.R, relative.t / np.linalg.norm(relative.t)
        self.placed = [a, b]
        if not self._adjust_roughly():
            return False
        adjusted = 2
        while self._place_next():
            # Adjusting all views after each new one would take quadratic time.
            if len(self.placed) >= 1.2 * adjusted:
                self._adjust_roughly()
                adjusted = len(self.placed)
        return True

    def finish(self) -> Placed | None:
        """Adjust all views in the frame of the first view; None if they have too few inliers."""
        self.placed.sort()
        a = self.placed[0]
        at = -np.einsum("vji,vj->vi", self.R[self.placed], self.t[self.placed])
        # The two views that define the unit of length should not be at one position.
        b = self.placed[int(np.linalg.norm(at - at[0], axis=1).argmax())]
        self.placed = [a, b, *(view for view in self.placed if view not in (a, b))]
        self.R = self.R @ self.R[a].T
        self.t = self.t - self.R @ self.t[a]
        self.t[a] = 0
        self.t /= max(float(np.linalg.norm(self.t[b])), 1e-12)
        for _ in range(2):
            last = self._adjust(1.0, FINAL_TRACKS, 30, 1e-6)
        return None if last is None else Placed(np.array(self.placed), last)

    def count_inliers(self) -> int:
        """Count the inlier observations."""
        return int(self._points(1.0)[1].sum())

    def _rays(self, mine: np.ndarray) -> np.ndarray:
        """Return the normalised image coordinates [M, 2] of observations."""
        view = self.tracks.view[mine]
        return (self.tracks.xy[mine] - self.centers[view]) / self.focals[self.group[view]][:, None]

    def _points(self, loose: float) -> tuple[np.ndarray, np.ndarray]:
        """Triangulate all tracks: points [T, 3] and inliers bool [M]."""
        view = self.tracks.view
        uv, focals = self._rays(np.arange(len(view))), self.focals[self.group[view]]
        return triangulate_inliers(
            self.tracks, np.isin(view, self.placed), self.R, self.t, uv, focals,
            loose * MAX_REPROJECTION_ERROR,
        )  # fmt: skip

    def _adjust_roughly(self) -> bool:
        """Adjust all placed views with few tracks; return False if there are too few inliers.

        Strict inliers are loose ones, so where the loose are too few, the strict are as well.
        """
        return all(
            self._adjust(loose, INTERMEDIATE_TRACKS, 10, 1e-4) is not None
            for loose in (UNADJUSTED_ERROR_FACTOR, 1.0)
        )

    def _adjust(
        self, loose: float, max_tracks: int, iterations: int, tolerance: float
    ) -> Adjusted | None:
        """Adjust all placed views; None if there are too few inliers."""
        tracks, placed = self.tracks, self.placed
        X, good = self._points(loose)
        mine = np.flatnonzero(good)
        length = np.bincount(tracks.track[mine], minlength=tracks.count)[tracks.track[mine]]
        order = mine[np.lexsort((tracks.track[mine], -length, tracks.view[mine]))]
        per_view = np.bincount(tracks.view[mine])
        rank = np.arange(len(order)) - np.repeat(np.cumsum(per_view) - per_view, per_view)
        selected = np.zeros(tracks.count, bool)
        selected[tracks.track[order[rank < max_tracks]]] = True
        mine = mine[selected[tracks.track[mine]]]
        if len(mine) < 4 * MIN_INLIERS:
            return None
        track_ids, point = np.unique(tracks.track[mine], return_inverse=True)
        number = np.zeros(len(self.centers), int)
        number[placed] = np.arange(len(placed))
        lenses, group = np.unique(self.group[placed], return_inverse=True)
        bundle = Bundle(
            R=self.R[placed],
            t=self.t[placed],
            centers=self.centers[placed],
            group=group,
            focals=self.focals[lenses],
            points=X[track_ids],
            view=number[tracks.view[mine]],
            point=point,
            xy=tracks.xy[mine],
            focal_prior=self.focal_prior[lenses],
            focal_sigma=self.focal_sigma[lenses],
        )
        adjusted = adjust(bundle, iterations=iterations, tolerance=tolerance)
        self.R[placed], self.t[placed] = adjusted.bundle.R, adjusted.bundle.t
        self.focals[lenses] = adjusted.bundle.focals
        return adjusted

    def _place_next(self) -> bool:
        """Place the view with most triangulated points that can be placed, if there is one."""
        tracks = self.tracks
        X, good = self._points(1.0)
        uv = self._rays(np.arange(len(tracks.view)))
        width = triangulation_angles(tracks, good, self.R, uv)
        left = np.setdiff1d(np.arange(len(self.centers)), self.placed)
        for minimum, wide in ATTEMPTS:
            sharp = (width > wide)[tracks.track]
            observed = {int(view): np.flatnonzero((tracks.view == view) & sharp) for view in left}
            for view in sorted(observed, key=lambda view: -len(observed[view])):
                pose = self._pose(view, observed[view], X, minimum)
                if pose is not None:
                    self.R[view], self.t[view] = pose
                    self.placed.append(view)
                    return True
        return False

    def _pose(
        self, view: int, mine: np.ndarray, X: np.ndarray, minimum: int
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the pose with most inliers; None if there are fewer than ``minimum``."""
        if len(mine) < minimum:
            return None
        points, lens = X[self.tracks.track[mine]], int(self.group[view])
        best, best_count = None, max(minimum, MIN_INLIER_SHARE * len(mine)) - 1
        for focal in self._focal_candidates(view):
            self.focals[lens] = focal
            uv, within = self._rays(mine), UNADJUSTED_ERROR_FACTOR * MAX_REPROJECTION_ERROR / focal
            for R, t in self._guesses(view, points, uv, within, minimum < MIN_INLIERS):
                local = points @ R.T + t
                residuals = local[:, :2] / np.where(local[:, 2:] > 0, local[:, 2:], 1) - uv
                near = (np.linalg.norm(residuals, axis=1) < within) & (local[:, 2] > 0)
                if near.sum() > best_count:
                    best, best_count = (R, t, focal, near), int(near.sum())
        if best is None:
            return None
        R, t, focal, near = best
        self.focals[lens] = focal
        self.placed_lenses.add(lens)
        if near.sum() < MIN_INLIERS:
            return R, t
        turn, t = cv2.solvePnPRefineLM(
            points[near], self._rays(mine)[near], np.eye(3), None, cv2.Rodrigues(R)[0], t[:, None]
        )
        return cv2.Rodrigues(turn)[0], t[:, 0]

    def _focal_candidates(self, view: int) -> list[float]:
        """Return the focal lengths to try for a view, pixels."""
        lens = int(self.group[view])
        if lens in self.placed_lenses or not self.focal_sigma[lens] > 0:
            return [float(self.focals[lens])]
        pair_focals = [
            tie.relative.focals[tie.views.index(view)]
            for tie in self.ties
            if view in tie.views and tie.relative is not None
        ]
        middle = float(np.median(pair_focals)) if pair_focals else float(self.focal_prior[lens])
        return [0.8 * middle, middle, 1.25 * middle]

    def _guesses(
        self, view: int, points: np.ndarray, uv: np.ndarray, within: float, tied: bool
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return candidate poses of a view from its points and its pairs with placed views.

        If ``tied``, only pairs of confidence ``TRUSTED_CONFIDENCE`` or more are used.
        """
        poses = []
        if not tied:
            cv2.setRNGSeed(0)
            options = {"iterationsCount": 500, "confidence": 0.999, "flags": cv2.SOLVEPNP_EPNP}
            ok, turn, t, _ = cv2.solvePnPRansac(
                points, uv, np.eye(3), None, reprojectionError=within, **options
            )
            if ok:
                poses.append((cv2.Rodrigues(turn)[0], t[:, 0]))
        for tie in self.ties:
            if view not in tie.views or tie.relative is None:
                continue
            neighbour = tie.views[1 - tie.views.index(view)]
            if neighbour not in self.placed or (tied and tie.confidence < TRUSTED_CONFIDENCE):
                continue
            R, t = tie.relative.R, tie.relative.t
            if tie.views[0] == view:
                R, t = R.T, -R.T @ t
            R, base, t = R @ self.R[neighbour], R @ self.t[neighbour], t / np.linalg.norm(t)
            # uv z = X + base + s t gives a scale s for each point; their median is used.
            local = points @ R.T + base
            slope = t[:2] - uv * t[2]
            scales = (slope * (uv * local[:, 2:] - local[:, :2])).sum(1)
            scales /= np.maximum((slope**2).sum(1), 1e-12)
            poses.append((R, base + float(np.median(scales)) * t))
        return poses
