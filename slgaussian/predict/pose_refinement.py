"""Given cameras, moved by the least that makes the matches of all views meet.

Depths of several views agree only if their cameras do: a pose is often off by some tenths of a
degree and a baseline by some per cent, which two views alone cannot know.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from slgaussian.cameras.bundle import Bundle, PosePrior, adjust
from slgaussian.cameras.tracks import join_tracks, triangulate
from slgaussian.scene import Camera

TURN = np.radians(0.15)
MOVE = 0.05
"""Standard deviations of a given pose that are assumed: of the rotation, and of the centre as a
share of the distance to the nearest other view."""

ITERATIONS, TOLERANCE = 30, 1e-5


def settle(
    cameras: Sequence[Camera],
    keypoints: Sequence[np.ndarray],
    matches: Mapping[tuple[int, int], tuple[np.ndarray, np.ndarray]],
) -> list[Camera]:
    """The cameras after a bundle adjustment that believes the given poses, and keeps all lenses.

    Parameters
    ----------
    cameras : V Camera
    keypoints : V of float64 [N, 2]
        Pixels, pixel centres at +0.5.
    matches : mapping (i, j) -> (int [M], int [M])
        Which keypoints of the views i and j show one point; at most gross errors among them.
    """
    if not matches:
        return list(cameras)
    tracks = join_tracks(keypoints, [(*pair, *found) for pair, found in matches.items()])
    K = np.array([camera.K for camera in cameras])
    focals = np.sqrt(K[:, 0, 0] * K[:, 1, 1])
    # As a camera of square pixels would have seen it.
    off = tracks.xy - K[tracks.view, :2, 2]
    uv = off / np.stack([K[tracks.view, 0, 0], K[tracks.view, 1, 1]], 1)
    w2c = np.array([camera.w2c for camera in cameras])
    R, t = w2c[:, :3, :3], w2c[:, :3, 3]
    points, _ = triangulate(R, t, tracks.view, tracks.track, uv)
    depth = np.einsum("mj,mj->m", R[tracks.view, 2], points[tracks.track]) + t[tracks.view, 2]
    front = np.ones(tracks.count, bool)
    np.logical_and.at(front, tracks.track, depth > 0)
    seen = front[tracks.track]
    kept, point = np.unique(tracks.track[seen], return_inverse=True)
    if not len(kept):
        return list(cameras)
    centers = np.array([camera.center for camera in cameras])
    apart = np.linalg.norm(centers[:, None] - centers, axis=-1)
    nearest = np.where(apart > 0, apart, np.inf).min(1)
    count = len(cameras)
    found = adjust(
        Bundle(
            R=R,
            t=t,
            centers=np.zeros((count, 2)),
            group=np.arange(count),
            focals=focals,
            k1=np.zeros(count),
            points=points[kept],
            view=tracks.view[seen],
            point=point,
            xy=uv[seen] * focals[tracks.view[seen], None],
            focal_prior=focals,
            focal_sigma=np.zeros(count),
            poses=PosePrior(R, centers, TURN, MOVE * nearest),
        ),
        iterations=ITERATIONS,
        tolerance=TOLERANCE,
    ).bundle
    back = found.R.transpose(0, 2, 1)
    stands = -(back @ found.t[:, :, None])[..., 0]
    return [placed(*one) for one in zip(cameras, back, stands, strict=True)]


def kept_near(
    given: Sequence[Camera], settled: Sequence[Camera], closeness: np.ndarray
) -> list[Camera]:
    """The settled cameras, moved back by what each shares with its neighbours.

    Given poses drift, and so does the frame in which somebody asks for a view: where all of a
    neighbourhood is off by the same, it stays there. What differs between neighbours is mended.

    Parameters
    ----------
    given, settled : V Camera
    closeness : float64 [V, V]
        Weights of the mean around each view; rows sum to 1.
    """
    R = np.array([camera.c2w[:3, :3] for camera in given])
    turns = Rotation.from_matrix(
        [b.c2w[:3, :3] @ a.c2w[:3, :3].T for a, b in zip(given, settled, strict=True)]
    ).as_rotvec()
    moves = np.array([b.center - a.center for a, b in zip(given, settled, strict=True)])
    turns, moves = turns - closeness @ turns, moves - closeness @ moves
    turned = Rotation.from_rotvec(turns).as_matrix() @ R
    stands = np.array([camera.center for camera in given]) + moves
    return [placed(*one) for one in zip(given, turned, stands, strict=True)]


def placed(camera: Camera, R: np.ndarray, center: np.ndarray) -> Camera:
    """The camera with another rotation [3, 3] (camera to world) and centre [3]."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R, center
    return replace(camera, c2w=pose)
