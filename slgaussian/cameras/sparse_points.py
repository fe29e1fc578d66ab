"""Points that the matches of photographs determine, given their cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slgaussian.cameras.incremental import MAX_REPROJECTION_ERROR
from slgaussian.cameras.match_graph import MatchGraph
from slgaussian.cameras.tracks import (
    Tracks,
    join_tracks,
    triangulate_inliers,
    triangulation_angles,
)
from slgaussian.cameras.two_view import MAX_IMAGE_SIDE
from slgaussian.scene import Camera

MIN_ANGLE = 0.4
"""Smallest angle between two lines of sight to a point, degrees: the smallest by which views are
placed (:data:`slgaussian.cameras.incremental.ATTEMPTS`)."""


def triangulate_matches(cameras: Sequence[Camera], graph: MatchGraph) -> tuple[Tracks, np.ndarray]:
    """Triangulate the points of all matches that agree with the cameras.

    A match counts if its point is in front of both cameras and is reprojected to within
    :data:`slgaussian.cameras.incremental.MAX_REPROJECTION_ERROR` pixels of the images in which
    features were detected; so does each observation of the tracks that those matches form.

    Args:
        cameras: sequence of V Camera. Of the whole photographs.
        graph: Matches of the V photographs, pixels of the whole photographs.

    Returns:
        Tracks, float64 [T, 3]: The observations, and their points in the world.
    """
    joins = [(*pair, *match) for pair, match in sorted(graph.matches.items()) if len(match[0])]
    if not joins:
        none = np.zeros(0, np.int64)
        return Tracks(none, none, np.zeros((0, 2)), 0), np.zeros((0, 3))
    # A wrong match would spoil the track that it joins, so each is a track of two views at first.
    counts = [len(first) for *_, first, _ in joins]
    view = np.repeat([[i, j] for i, j, *_ in joins], counts, axis=0).ravel()
    xy = np.concatenate([np.stack(graph.points(i, j), 1).reshape(-1, 2) for i, j, *_ in joins])
    single = Tracks(view, np.repeat(np.arange(sum(counts)), 2), xy, sum(counts))
    right = np.split(_inliers(cameras, single)[1][::2], np.cumsum(counts)[:-1])
    tracks = join_tracks(
        graph.keypoints,
        [(i, j, a[keep], b[keep]) for (i, j, a, b), keep in zip(joins, right, strict=True)],
    )
    points, good = _inliers(cameras, tracks)
    number, track = np.unique(tracks.track[good], return_inverse=True)
    return Tracks(tracks.view[good], track, tracks.xy[good], len(number)), points[number]


def _inliers(cameras: Sequence[Camera], tracks: Tracks) -> tuple[np.ndarray, np.ndarray]:
    """Return points [T, 3], and the inliers [M] of those whose lines of sight form an angle."""
    w2c = np.array([camera.w2c for camera in cameras])
    K = np.array([camera.K for camera in cameras])[tracks.view]
    uv = (tracks.xy - K[:, :2, 2]) / K[:, [0, 1], [0, 1]]
    longer = np.array([max(camera.width, camera.height) for camera in cameras])[tracks.view]
    focals = K[:, 0, 0] * np.minimum(1, MAX_IMAGE_SIDE / longer)
    every = np.ones(len(tracks.view), bool)
    R, t = w2c[:, :3, :3], w2c[:, :3, 3]
    points, good = triangulate_inliers(tracks, every, R, t, uv, focals, MAX_REPROJECTION_ERROR)
    wide = triangulation_angles(tracks, good, R, uv) >= MIN_ANGLE
    return points, good & wide[tracks.track]
