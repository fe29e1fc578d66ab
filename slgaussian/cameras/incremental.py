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
from slgaussian.cameras.tracks import Tracks, join_tracks, triangulate
from slgaussian.io import short_repr

PIXELS = 3.0
"""Largest reprojection error of an inlier, pixels."""

LOOSE = 3.0
"""Factor of ``PIXELS`` before the focal length has been adjusted to the view."""

WIDE = (1.5, 0.4)
"""Smallest triangulation angles, degrees, of the points by which views are placed; the second is
used if no more views can be placed with the first."""

LEAST, SHARE = 12, 0.25
"""Smallest number of inliers, and fraction of the view's observations, to place a view."""

TRUSTED, TIED = 0.5, 5
"""With a pose from a pair of this confidence, this many points suffice for the scale."""

STARTS, ENOUGH = 4, 0.9
"""Largest number of initial pairs tried, and fraction of inlier observations that, with all views
placed, ends the search."""

FEW, MANY = 250, 1000
"""Tracks per view in an intermediate and in the final bundle adjustment, the longest first."""


@dataclass(frozen=True, eq=False)
class Tie:
    """Matches and relative pose of two views.

    Attributes:
        views: (int, int)
        features: (int64 [M], int64 [M]). Indices of matching features that are inliers of the
            relative pose, in each view.
        xy: float64 [M, 2]. Positions of the first view's features in the second view, pixels; may
            be more accurate than the keypoints of the second view.
        pose: (float64 [3, 3], float64 [3]) or None. R and t of ``X_second = R @ X_first + t``, t up
            to scale; None if unknown.
        focals: (float, float) or None. Pixels, if the pose is known.
        angle: Degrees between the two lines of sight, median.
        confidence: Probability, 0 to 1, that the relative pose is right; matches are used
            regardless.
    """

    views: tuple[int, int]
    features: tuple[np.ndarray, np.ndarray]
    xy: np.ndarray
    pose: tuple[np.ndarray, np.ndarray] | None
    focals: tuple[float, float] | None
    angle: float
    confidence: float

    __repr__ = short_repr


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

    __repr__ = short_repr


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
    tracks = _tracks(keypoints, ties)
    ends = np.array([tie.views for tie in ties]).T
    tied = coo_array((np.ones(len(ties)), tuple(ends)), shape=(len(keypoints),) * 2)
    _, piece = connected_components(tied, directed=False)
    together = np.bincount(piece)[
        piece
    ]  # size of each tie's connected component: more views cannot be placed

    def worth(tie: Tie) -> tuple[int, float]:
        width = min(tie.angle, 8.0) ** 0.5
        return together[tie.views[0]], len(tie.features[0]) * width * (0.1 + tie.confidence)

    starts = sorted((tie for tie in ties if tie.pose is not None), key=worth, reverse=True)
    trials: list[tuple[tuple[int, int], _Reconstruction]] = []
    for start in starts[:STARTS]:
        grown = _Reconstruction(tracks, centers, group, focal_prior, focal_sigma, ties)
        if not grown.grow(start):
            continue
        explained = grown.explained()
        trials.append(((len(grown.placed), explained), grown))
        if len(grown.placed) == len(keypoints) and explained > ENOUGH * len(tracks.view):
            break
    return max(trials, key=lambda trial: trial[0])[1].finished() if trials else None


def _tracks(keypoints: Sequence[np.ndarray], ties: Sequence[Tie]) -> Tracks:
    """Join the matches of the ties into tracks.

    Positions in later views are those of the feature in the first view (``Tie.xy``).
    """
    points = [view_points.copy() for view_points in keypoints]
    for tie in reversed(ties):
        points[tie.views[1]][tie.features[1]] = tie.xy
    return join_tracks(points, [(*tie.views, *tie.features) for tie in ties])


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
        a, b = start.views
        assert start.pose is not None and start.focals is not None
        self._add_lens(a, start.focals[0])
        self._add_lens(b, start.focals[1])
        self.R[b], self.t[b] = start.pose[0], start.pose[1] / np.linalg.norm(start.pose[1])
        self.placed = [a, b]
        if self._adjust(LOOSE, FEW) is None or self._adjust(1.0, FEW) is None:
            return False
        adjusted = 2
        while (left := self._next_view()) is not None:
            view, pose = left
            self.R[view], self.t[view] = pose
            self.placed.append(view)
            # Adjusting all views after each new one would take quadratic time.
            if len(self.placed) >= 1.2 * adjusted:
                self._adjust(LOOSE, FEW)
                self._adjust(1.0, FEW)
                adjusted = len(self.placed)
        return True

    def finished(self) -> Placed | None:
        """Adjust all views in the frame of the first view; None if they have too few inliers."""
        self.placed.sort()
        a = self.placed[0]
        at = -np.einsum("vji,vj->vi", self.R[self.placed], self.t[self.placed])
        # The two views that define the unit of length should not be at one position.
        b = self.placed[int(np.linalg.norm(at - at[0], axis=1).argmax())]
        self.placed = [a, b, *(view for view in self.placed if view not in (a, b))]
        self._reframe()
        for _ in range(2):
            last = self._adjust(1.0, MANY)
        return None if last is None else Placed(np.array(self.placed), last)

    def explained(self) -> int:
        """Count the inlier observations."""
        return int(self._points(1.0)[1].sum())

    def _add_lens(self, view: int, focal: float) -> None:
        """Initialise the focal length of a view's lens from a pair, unless the lens is in use."""
        lens = int(self.group[view])
        if lens not in self.placed_lenses and self.focal_sigma[lens] > 0:
            self.focals[lens] = focal
        self.placed_lenses.add(lens)

    def _reframe(self) -> None:
        a, b = self.placed[:2]
        R, t = self.R[a].copy(), self.t[a].copy()
        self.R = self.R @ R.T
        self.t = self.t - self.R @ t
        self.t[a] = 0
        self.t /= max(float(np.linalg.norm(self.t[b])), 1e-12)

    def _rays(self, mine: np.ndarray) -> np.ndarray:
        """Return the normalised image coordinates [M, 2] of observations."""
        view = self.tracks.view[mine]
        return (self.tracks.xy[mine] - self.centers[view]) / self.focals[self.group[view]][:, None]

    def _points(self, loose: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Triangulate all tracks: points [T, 3], inliers bool [M], and angles [T] in degrees."""
        tracks = self.tracks
        inside = np.zeros(len(self.centers), bool)
        inside[self.placed] = True
        good = inside[tracks.view]
        X = np.zeros((tracks.count, 3))
        every = np.flatnonzero(good)
        uv = np.zeros_like(tracks.xy)
        uv[every] = self._rays(every)
        for _ in range(4):
            mine = np.flatnonzero(good)
            counts = np.bincount(tracks.track[mine], minlength=tracks.count)
            mine = mine[counts[tracks.track[mine]] > 1]
            good = np.zeros(len(good), bool)
            good[mine] = True
            view, track = tracks.view[mine], tracks.track[mine]
            if not len(mine):
                break
            points, start = triangulate(self.R, self.t, view, track, uv[mine])
            X[track[start]] = points
            local = (self.R[view] @ X[track, :, None])[..., 0] + self.t[view]
            front = local[:, 2] > 0
            off = local[:, :2] / np.where(front, local[:, 2], 1)[:, None] - uv[mine]
            error = np.linalg.norm(off, axis=1) * self.focals[self.group[view]]
            error = np.where(front, error, 1e9)
            # Only the worst observation of a track is dropped at a time: it may bias the others.
            worst = np.maximum.reduceat(error, start)[np.cumsum(np.diff(track, prepend=-1) > 0) - 1]
            bad = (error > loose * PIXELS) & (error >= worst)
            good[mine[bad]] = False
            if not bad.any():
                break
        mine = np.flatnonzero(good)
        counts = np.bincount(tracks.track[mine], minlength=tracks.count)
        good[mine[counts[tracks.track[mine]] < 2]] = False
        return X, good, self._widths(uv, good)

    def _widths(self, uv: np.ndarray, good: np.ndarray) -> np.ndarray:
        """Compute the largest angle [T] to the first line of sight of each track, degrees."""
        widths = np.zeros(self.tracks.count)
        mine = np.flatnonzero(good)
        if not len(mine):
            return widths
        view, track = self.tracks.view[mine], self.tracks.track[mine]
        rays = np.concatenate([uv[mine], np.ones((len(mine), 1))], 1)[:, None] @ self.R[view]
        rays = rays[:, 0] / np.linalg.norm(rays[:, 0], axis=1, keepdims=True)
        new = np.diff(track, prepend=-1) > 0
        start = np.flatnonzero(new)
        cosine = (rays * rays[start[np.cumsum(new) - 1]]).sum(1)
        widths[track[start]] = np.degrees(
            np.arccos(np.clip(np.minimum.reduceat(cosine, start), -1, 1))
        )
        return widths

    def _adjust(self, loose: float, max_tracks: int) -> Adjusted | None:
        """Adjust all placed views; None if there are too few inliers."""
        tracks = self.tracks
        X, good, _ = self._points(loose)
        mine = np.flatnonzero(good)
        length = np.bincount(tracks.track[mine], minlength=tracks.count)[tracks.track[mine]]
        order = np.lexsort((tracks.track[mine], -length, tracks.view[mine]))
        view = tracks.view[mine][order]
        new = np.diff(view, prepend=-1) > 0
        place = np.arange(len(view)) - np.flatnonzero(new)[np.cumsum(new) - 1]
        wanted = np.zeros(tracks.count, bool)
        wanted[tracks.track[mine][order[place < max_tracks]]] = True
        mine = mine[wanted[tracks.track[mine]]]
        if len(mine) < 4 * LEAST:
            return None
        track_ids, point = np.unique(tracks.track[mine], return_inverse=True)
        number = np.zeros(len(self.centers), int)
        number[self.placed] = np.arange(len(self.placed))
        lenses, group = np.unique(self.group[self.placed], return_inverse=True)
        bundle = Bundle(
            R=self.R[self.placed],
            t=self.t[self.placed],
            centers=self.centers[self.placed],
            group=group,
            focals=self.focals[lenses],
            points=X[track_ids],
            view=number[tracks.view[mine]],
            point=point,
            xy=tracks.xy[mine],
            focal_prior=self.focal_prior[lenses],
            focal_sigma=self.focal_sigma[lenses],
        )
        on_the_way = max_tracks == FEW
        adjusted = adjust(
            bundle,
            iterations=10 if on_the_way else 30,
            tolerance=1e-4 if on_the_way else 1e-6,
        )
        self.R[self.placed], self.t[self.placed] = adjusted.bundle.R, adjusted.bundle.t
        self.focals[lenses] = adjusted.bundle.focals
        return adjusted

    def _next_view(self) -> tuple[int, tuple[np.ndarray, np.ndarray]] | None:
        """Return the view with most triangulated points that can be placed, and its pose."""
        tracks = self.tracks
        X, good, width = self._points(1.0)
        triangulated = np.zeros(tracks.count, bool)
        triangulated[tracks.track[good]] = True
        left = np.setdiff1d(np.arange(len(self.centers)), self.placed)
        for wide in WIDE:
            sharp = (triangulated & (width > wide))[tracks.track]
            observed = {int(view): np.flatnonzero((tracks.view == view) & sharp) for view in left}
            for view in sorted(observed, key=lambda view: -len(observed[view])):
                pose = self._pose(view, observed[view], X, LEAST)
                if pose is not None:
                    return view, pose
        for view in sorted(observed, key=lambda view: -len(observed[view])):
            pose = self._pose(view, observed[view], X, TIED)
            if pose is not None:
                return view, pose
        return None

    def _pose(
        self, view: int, mine: np.ndarray, X: np.ndarray, minimum: int
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the pose with most inliers; None if there are fewer than ``minimum``."""
        if len(mine) < minimum:
            return None
        points, lens = X[self.tracks.track[mine]], int(self.group[view])
        best, best_count = None, max(minimum, SHARE * len(mine)) - 1
        for focal in self._focal_candidates(view):
            self.focals[lens] = focal
            uv, within = self._rays(mine), LOOSE * PIXELS / focal
            for R, t in self._guesses(view, points, uv, within, minimum < LEAST):
                local = points @ R.T + t
                off = local[:, :2] / np.where(local[:, 2:] > 0, local[:, 2:], 1) - uv
                near = (np.linalg.norm(off, axis=1) < within) & (local[:, 2] > 0)
                if near.sum() > best_count:
                    best, best_count = (R, t, focal, near), int(near.sum())
        if best is None:
            return None
        R, t, focal, near = best
        self.focals[lens] = focal
        self.placed_lenses.add(lens)
        if near.sum() < LEAST:
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
            tie.focals[tie.views.index(view)]
            for tie in self.ties
            if view in tie.views and tie.focals is not None
        ]
        middle = float(np.median(pair_focals)) if pair_focals else float(self.focal_prior[lens])
        return [0.8 * middle, middle, 1.25 * middle]

    def _guesses(
        self, view: int, points: np.ndarray, uv: np.ndarray, within: float, tied: bool
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return candidate poses of a view from its points and its pairs with placed views.

        If ``tied``, only pairs of confidence ``TRUSTED`` or more are used.
        """
        poses = []
        if not tied:
            cv2.setRNGSeed(0)
            ok, turn, t, _ = cv2.solvePnPRansac(
                points,
                uv,
                np.eye(3),
                None,
                reprojectionError=within,
                iterationsCount=500,
                confidence=0.999,
                flags=cv2.SOLVEPNP_EPNP,
            )
            if ok:
                poses.append((cv2.Rodrigues(turn)[0], t[:, 0]))
        for tie in self.ties:
            if view not in tie.views or tie.pose is None:
                continue
            neighbour = tie.views[1 - tie.views.index(view)]
            if neighbour not in self.placed or (tied and tie.confidence < TRUSTED):
                continue
            R, t = tie.pose
            if tie.views[0] == view:
                R, t = R.T, -R.T @ t
            R, base, t = R @ self.R[neighbour], R @ self.t[neighbour], t / np.linalg.norm(t)
            # uv z = X + base + s t gives a scale s for each point; their median is used.
            local = points @ R.T + base
            slope = t[:2] - uv * t[2]
            scales = (slope * (uv * local[:, 2:] - local[:, :2])).sum(1) / np.maximum(
                (slope**2).sum(1), 1e-12
            )
            poses.append((R, base + float(np.median(scales)) * t))
        return poses
