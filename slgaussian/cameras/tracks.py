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
