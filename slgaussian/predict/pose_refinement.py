"""Refinement of given camera poses by matches, with the given poses as a prior.

Depth maps of several views agree only if their cameras do. Given poses often have errors of some
tenths of a degree and baselines of some per cent, which two views alone cannot reveal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from slgaussian.cameras.bundle import Bundle, PosePrior, adjust
from slgaussian.cameras.relative import Relative
from slgaussian.cameras.tracks import join_tracks, triangulate
from slgaussian.scene import Camera

ROTATION_STD = np.radians(0.15)
CENTER_STD = 0.05
"""Assumed standard deviations of a given pose: of the rotation, radians, and of the centre, as a
share of the distance to the nearest other view."""

ITERATIONS, TOLERANCE = 30, 1e-5

MIN_REFINED_MATCHES = 30
"""Smallest number of matches near their epipolar lines for a refinement of the pose."""

MAX_EPIPOLAR_DISTANCE = 0.02
"""Distance to the epipolar line, as a share of the image diagonal, beyond which a match is an
outlier under the given pose: 0.02 allows about one degree of rotation at common focal lengths."""

RELATIVE_ROTATION_STD = np.radians(0.3)
RELATIVE_DIRECTION_STD = np.radians(5.0)
"""Assumed standard deviations of a given relative pose. The direction of a short baseline is its
least certain part."""


def refine(prior: Relative, ref: np.ndarray, src: np.ndarray) -> Relative:
    """Refine rotation and translation direction by the Sampson distance of matches.

    Robust least squares with the given pose as a prior. The baseline length does not change; with
    fewer than :data:`MIN_REFINED_MATCHES` matches neither does the pose.

    Args:
        prior: The given pose.
        ref, src: float64 [M, 2]. Matched pixels of the reference and the source.
    """
    if len(ref) < MIN_REFINED_MATCHES:
        return prior
    length = np.linalg.norm(prior.t)
    direction = prior.t / length
    # Two axes orthogonal to the direction of translation.
    across = np.linalg.svd(direction[None])[2][1:]

    def apply_step(step: np.ndarray) -> Relative:
        turned = direction + step[3:] @ across
        R = cv2.Rodrigues(step[:3])[0] @ prior.R
        return replace(prior, R=R, t=turned * (length / np.linalg.norm(turned)))

    deviation = np.repeat([RELATIVE_ROTATION_STD, RELATIVE_DIRECTION_STD], [3, 2])

    def residuals(step: np.ndarray) -> np.ndarray:
        return np.concatenate([apply_step(step).epipolar_distance(ref, src), step / deviation])

    from scipy.optimize import least_squares  # slow to import, and needed only here

    fit = least_squares(residuals, np.zeros(5), loss="cauchy", f_scale=0.5, x_scale=deviation)
    return apply_step(fit.x)


def refine_cameras(
    cameras: Sequence[Camera],
    keypoints: Sequence[np.ndarray],
    matches: Mapping[tuple[int, int], tuple[np.ndarray, np.ndarray]],
) -> list[Camera]:
    """Adjust poses so that matches agree; intrinsics stay fixed and the given poses are a prior.

    Args:
        cameras: V Camera
        keypoints: V of float64 [N, 2]. Pixels, pixel centres at +0.5.
        matches: mapping (i, j) -> (int [M], int [M]). Indices of corresponding keypoints of the
            views i and j, with few outliers.
    """
    if not matches:
        return list(cameras)
    tracks = join_tracks(keypoints, [(*pair, *indices) for pair, indices in matches.items()])
    K = np.array([camera.K for camera in cameras])
    focals = np.sqrt(K[:, 0, 0] * K[:, 1, 1])
    # Pixels relative to the principal point, scaled to square pixels below.
    centred = tracks.xy - K[tracks.view, :2, 2]
    uv = centred / np.stack([K[tracks.view, 0, 0], K[tracks.view, 1, 1]], 1)
    w2c = np.array([camera.w2c for camera in cameras])
    R, t = w2c[:, :3, :3], w2c[:, :3, 3]
    points, _ = triangulate(R, t, tracks.view, tracks.track, uv)
    depth = np.einsum("mj,mj->m", R[tracks.view, 2], points[tracks.track]) + t[tracks.view, 2]
    front = np.ones(tracks.count, bool)
    np.logical_and.at(front, tracks.track, depth > 0)
    in_front = front[tracks.track]
    used_tracks, point = np.unique(tracks.track[in_front], return_inverse=True)
    if not len(used_tracks):
        return list(cameras)
    centers = np.array([camera.center for camera in cameras])
    distances = np.linalg.norm(centers[:, None] - centers, axis=-1)
    nearest = np.where(distances > 0, distances, np.inf).min(1)
    count = len(cameras)
    bundle = adjust(
        Bundle(
            R=R,
            t=t,
            centers=np.zeros((count, 2)),
            group=np.arange(count),
            focals=focals,
            points=points[used_tracks],
            view=tracks.view[in_front],
            point=point,
            xy=uv[in_front] * focals[tracks.view[in_front], None],
            focal_prior=focals,
            focal_sigma=np.zeros(count),
            poses=PosePrior(R, centers, ROTATION_STD, CENTER_STD * nearest),
        ),
        iterations=ITERATIONS,
        tolerance=TOLERANCE,
    ).bundle
    rotations = bundle.R.transpose(0, 2, 1)
    return _replace_poses(cameras, rotations, -(rotations @ bundle.t[:, :, None])[..., 0])


def anchor_cameras(
    cameras: Sequence[Camera], refined: Sequence[Camera], closeness: np.ndarray
) -> list[Camera]:
    """Remove from a refinement the part that neighbouring views have in common.

    Given poses drift slowly, and novel views are requested in the drifting frame. So a correction
    that a whole neighbourhood shares is undone, and only differences between neighbours remain.

    Args:
        cameras, refined: V Camera. The given cameras, and those of :func:`refine_cameras`.
        closeness: float64 [V, V]. Weights of the mean around each view; rows sum to 1.
    """
    R = np.array([camera.c2w[:3, :3] for camera in cameras])
    turns = Rotation.from_matrix(
        [b.c2w[:3, :3] @ a.c2w[:3, :3].T for a, b in zip(cameras, refined, strict=True)]
    ).as_rotvec()
    moves = np.array([b.center - a.center for a, b in zip(cameras, refined, strict=True)])
    turns, moves = turns - closeness @ turns, moves - closeness @ moves
    rotations = Rotation.from_rotvec(turns).as_matrix() @ R
    return _replace_poses(
        cameras, rotations, np.array([camera.center for camera in cameras]) + moves
    )


def _replace_poses(cameras: Sequence[Camera], R: np.ndarray, centers: np.ndarray) -> list[Camera]:
    """Return the cameras with rotations ``R`` [V, 3, 3] (camera to world) and centres [V, 3]."""
    poses = np.tile(np.eye(4), (len(cameras), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = R, centers
    return [replace(camera, c2w=pose) for camera, pose in zip(cameras, poses, strict=True)]
