"""Tracks: matches of pairs of views joined into one track per point, and triangulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Join = tuple[int, int, np.ndarray, np.ndarray]
"""Two views and the indices of their matching keypoints, int [M] and int [M]."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """Observations of points, sorted by point.

    Attributes:
        view, track: int64 [M]
        xy: float64 [M, 2]. Observed pixels.
        count: Number of tracks; each has observations in two or more views.
    """

    view: np.ndarray
    track: np.ndarray
    xy: np.ndarray
    count: int


def join_tracks(keypoints: Sequence[np.ndarray], joins: Sequence[Join]) -> Tracks:
    """Join matches into tracks; tracks with two keypoints in one view are dropped.

    ``keypoints`` are V arrays float64 [N, 2], pixels.
    """
    offsets = np.cumsum([0, *(len(points) for points in keypoints)])
    view = np.repeat(np.arange(len(keypoints)), np.diff(offsets))
    ends = [np.concatenate([offsets[join[k]] + join[2 + k] for join in joins]) for k in (0, 1)]
    total = int(offsets[-1])
    joined = coo_array((np.ones(len(ends[0])), tuple(ends)), shape=(total, total))
    _, label = connected_components(joined, directed=False)
    size = np.bincount(label)
    twice, times = np.unique(label * len(keypoints) + view, return_counts=True)
    good = size > 1
    good[twice[times > 1] // len(keypoints)] = False
    members = np.flatnonzero(good[label])
    labels, track = np.unique(label[members], return_inverse=True)
    order = np.argsort(track, kind="stable")
    xy = np.concatenate(list(keypoints))
    return Tracks(view[members][order], track[order], xy[members][order], len(labels))


def triangulate(
    R: np.ndarray, t: np.ndarray, view: np.ndarray, track: np.ndarray, uv: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Triangulate points of least algebraic error (Hartley and Zisserman, ch. 12.2).

    Args:
        R, t: float64 [V, 3, 3], [V, 3]. World to camera.
        view, track: int64 [M]. View and track of each observation, sorted by track.
        uv: float64 [M, 2]. Normalised image coordinates.

    Returns:
        float64 [T, 3], int64 [T]: The point of each track that occurs, in order, and the index of
            its first observation.
    """
    pose = np.concatenate([R, t[:, :, None]], 2)
    rows = uv[:, :, None] * pose[view, 2:3] - pose[view, :2]
    start = np.flatnonzero(np.diff(track, prepend=-1))
    A = np.add.reduceat(rows.transpose(0, 2, 1) @ rows, start)
    q = np.linalg.eigh(A)[1][:, :, 0]
    w = np.where(np.abs(q[:, 3]) > 1e-9, q[:, 3], 1e-9)
    return q[:, :3] / w[:, None], start


def triangulate_inliers(
    tracks: Tracks, good: np.ndarray, R: np.ndarray, t: np.ndarray, uv: np.ndarray,
    focals: np.ndarray, max_error: float,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Triangulate tracks without their outliers.

    Args:
        good: bool [M]. Observations to use.
        R, t: float64 [V, 3, 3], [V, 3]. World to camera.
        uv: float64 [M, 2]. Normalised image coordinates.
        focals: float64 [M]. Focal length in pixels of the view of each observation.
        max_error: Largest reprojection error of an inlier, in these pixels.

    Returns:
        float64 [T, 3], bool [M]: The points, valid for tracks with inliers, and the inliers, two
            or more in each such track.
    """
    X = np.zeros((tracks.count, 3))
    for _ in range(4):
        good = _without_single(tracks, good)
        mine = np.flatnonzero(good)
        if not len(mine):
            break
        view, track = tracks.view[mine], tracks.track[mine]
        points, start = triangulate(R, t, view, track, uv[mine])
        X[track[start]] = points
        local = (R[view] @ X[track, :, None])[..., 0] + t[view]
        front = local[:, 2] > 0
        residuals = local[:, :2] / np.where(front, local[:, 2], 1)[:, None] - uv[mine]
        error = np.linalg.norm(residuals, axis=1) * focals[mine]
        error = np.where(front, error, 1e9)
        # Only the worst observation of a track is dropped at a time: it may bias the others.
        worst = np.repeat(np.maximum.reduceat(error, start), np.diff(start, append=len(mine)))
        bad = (error > max_error) & (error >= worst)
        good[mine[bad]] = False
        if not bad.any():
            break
    return X, _without_single(tracks, good)


def _without_single(tracks: Tracks, good: np.ndarray) -> np.ndarray:
    """Return the mask ``good`` [M] without observations that are alone in their track."""
    counts = np.bincount(tracks.track[good], minlength=tracks.count)
    return good & (counts[tracks.track] > 1)


def triangulation_angles(
    tracks: Tracks, good: np.ndarray, R: np.ndarray, uv: np.ndarray
) -> np.ndarray:
    """Compute the largest angle [T] to the first line of sight of each track, degrees.

    Tracks without observations in ``good`` have 0; arguments as :func:`triangulate_inliers`.
    """
    angles = np.zeros(tracks.count)
    mine = np.flatnonzero(good)
    if not len(mine):
        return angles
    view, track = tracks.view[mine], tracks.track[mine]
    rays = np.concatenate([uv[mine], np.ones((len(mine), 1))], 1)[:, None]
    rays = (rays @ R[view])[:, 0]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    start = np.flatnonzero(np.diff(track, prepend=-1))
    first = np.repeat(rays[start], np.diff(start, append=len(mine)), axis=0)
    cosine = np.minimum.reduceat((rays * first).sum(1), start)
    angles[track[start]] = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return angles
