"""Found cameras and points as a sparse model of photographs as they are stored.

COLMAP, LLFF and most programs that train on their files ignore the EXIF orientation, while cameras
are found for upright photographs: here they are turned back, and the distortion of the lens is
part of the camera.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from slgaussian.cameras.estimated import EstimatedCameras
from slgaussian.cameras.sparse_points import triangulate_matches
from slgaussian.cameras.tracks import Tracks
from slgaussian.datasets.exif import read_orientation
from slgaussian.datasets.unposed import photograph
from slgaussian.errors import InputError
from slgaussian.formats.images import open_image, unreadable
from slgaussian.io import short_repr
from slgaussian.scene import Camera

STORED_AXES = {
    1: np.eye(2), 3: -np.eye(2), 6: np.array([[0, 1], [-1, 0]]), 8: np.array([[0, -1], [1, 0]])
}  # fmt: skip
"""Rotation of upright pixels, from the image centre, to stored ones, by EXIF orientation."""


@dataclass(frozen=True, eq=False)
class SparseModel:
    """Cameras of stored photographs and the points that they show.

    Attributes:
        cameras: mapping str -> Camera. V cameras by the names of photographs.
        distortions: mapping str -> float. Brown's k1 of the cameras that have one.
        tracks: Observations of P points, pixels of the stored photographs.
        points: float64 [P, 3]. World.
        colours: uint8 [P, 3]. RGB, mean of the observations.
        errors: float64 [P]. Mean reprojection error of the observations, pixels.
    """

    cameras: Mapping[str, Camera]
    distortions: Mapping[str, float]
    tracks: Tracks
    points: np.ndarray
    colours: np.ndarray
    errors: np.ndarray

    __repr__ = short_repr


def build_sparse_model(photographs: Mapping[str, Path], estimated: EstimatedCameras) -> SparseModel:
    """Triangulate the matches of found cameras, and describe the photographs as they are stored.

    Args:
        photographs: mapping str -> path. Photographs by the names of their cameras.

    Raises:
        InputError: If a photograph cannot be read, or is stored as its mirror image.
    """
    upright = list(estimated.cameras.values())
    assert estimated.matches is not None  # found cameras have matches
    tracks, points = triangulate_matches(upright, estimated.matches)
    xy, colours, residuals = tracks.xy.copy(), np.zeros((len(tracks.xy), 3)), tracks.xy.copy()
    cameras = {}
    for number, (name, camera) in enumerate(estimated.cameras.items()):
        mine, k1 = tracks.view == number, estimated.distortions.get(name, 0.0)
        size = np.array([camera.width, camera.height])
        seen = distort(camera, k1, tracks.xy[mine])
        image = photograph(photographs[name], name).image
        shown = (seen / size * image.shape[1::-1]).astype(int)
        column, row = shown.clip(0, np.array(image.shape[1::-1]) - 1).T
        colours[mine] = image[row, column]
        local = points[tracks.track[mine]] @ camera.w2c[:3, :3].T + camera.w2c[:3, 3]
        ideal = local @ camera.K.T
        residuals[mine] = distort(camera, k1, ideal[:, :2] / ideal[:, 2:]) - seen
        cameras[name], turn = turn_as_stored(camera, photographs[name])
        stored_size = [cameras[name].width, cameras[name].height]
        xy[mine] = (seen - size / 2) @ turn.T + np.array(stored_size) / 2
    counts = np.bincount(tracks.track, minlength=tracks.count)
    distances = np.linalg.norm(residuals, axis=1)
    errors = np.bincount(tracks.track, distances, tracks.count) / counts
    sums = [np.bincount(tracks.track, channel, tracks.count) for channel in colours.T]
    means = np.rint(np.stack(sums, 1) / counts[:, None]).astype(np.uint8)
    return SparseModel(
        cameras, estimated.distortions, replace(tracks, xy=xy), points, means, errors
    )


def distort(camera: Camera, k1: float, xy: np.ndarray) -> np.ndarray:
    """Map pixels [N, 2] of an undistorted photograph to those of the distorted one."""
    centre, focals = camera.K[:2, 2], camera.K[[0, 1], [0, 1]]
    radii = np.linalg.norm((xy - centre) / focals, axis=1, keepdims=True)
    return centre + (xy - centre) * (1 + k1 * radii**2)


def turn_as_stored(camera: Camera, file: Path) -> tuple[Camera, np.ndarray]:
    """Return the camera of the stored photograph, and the rotation [2, 2] of its pixels."""
    try:
        with open_image(file) as image:
            orientation = read_orientation(image)
    except (OSError, ValueError) as problem:
        raise unreadable(file, problem) from None
    if orientation not in STORED_AXES:
        raise InputError(
            f"{file}: is stored as a mirror image (EXIF orientation {orientation}), which no "
            "camera takes; save it upright, or write transforms.json"
        )
    turn = STORED_AXES[orientation]
    size = np.abs(turn) @ [camera.width, camera.height]
    K, c2w = np.eye(3), camera.c2w.copy()
    K[[0, 1], [0, 1]] = np.abs(turn) @ camera.K[[0, 1], [0, 1]]
    K[:2, 2] = turn @ (camera.K[:2, 2] - np.array([camera.width, camera.height]) / 2) + size / 2
    c2w[:3, :2] = c2w[:3, :2] @ turn.T
    return replace(camera, K=K, c2w=c2w, width=int(size[0]), height=int(size[1])), turn
