"""Cameras from an NPZ of geometry, as written by Depth Anything 3 and users of VGGT or DUSt3R.

Such a file does not state whether its poses are world-to-camera, nor whether its intrinsics belong
to the stored photographs or to the stretched, cropped or padded input of the network. The reader
selects the interpretation that agrees with the depth and with feature matches, as
:mod:`slgaussian.predict.precomputed` does.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise, product
from pathlib import Path

import cv2
import numpy as np

from slgaussian.cameras.check import COARSE_DISTANCE, agree
from slgaussian.cameras.matches import LOWE_RATIO, match, sift
from slgaussian.cameras.two_view import Photograph
from slgaussian.checks import check_intrinsics
from slgaussian.datasets.photographs import make_scene
from slgaussian.datasets.unposed import find_folder, name_files, photograph
from slgaussian.errors import InputError
from slgaussian.formats.depth_maps import GeometryFile, geometry_files, read_geometry
from slgaussian.io import file_digest
from slgaussian.predict import precomputed
from slgaussian.scene import Camera, Scene

TESTED_PHOTOGRAPHS = 6
"""Number of photographs, the first, by which the interpretation is selected."""

TESTED_SIDE = 640  # longer side of these photographs, pixels

POSE_CONVENTIONS = {
    "camera-to-world in OpenCV's axes": (False, False),
    "world-to-camera in OpenCV's axes": (True, False),
    "camera-to-world in OpenGL's axes": (False, True),
    "world-to-camera in OpenGL's axes": (True, True),
}
"""Whether to invert the poses, and then to reverse y and z, by convention."""

FLIP_YZ = np.diag([1.0, -1.0, -1.0, 1.0])


def read(path: str | Path, photographs: str | Sequence[str] | None = None) -> Scene:
    """Read a scene of photographs with the cameras of an NPZ.

    Args:
        path: NPZ or folder, see :func:`slgaussian.formats.depth_maps.read_geometry`.
        photographs: str or sequence of str, optional. Their folder relative to that of the NPZ, the
            default; or files and folders. If the NPZ has no ``names``, its maps belong to all
            photographs in order, in a folder sorted by name.

    Raises:
        InputError: If the NPZ cannot be read or has no cameras, the number of photographs differs,
            or no interpretation of its numbers fits them.
    """
    path = Path(path)
    if photographs is None or isinstance(photographs, str):
        photographs = [str(path.parent / (photographs or "."))]
    files = name_files(photographs)
    digest = "".join(file_digest(file) for file in geometry_files(path))
    stamped = tuple((name, file, file_digest(file)) for name, file in files.items())
    cameras = _cameras(path, digest, stamped)
    posed_files = {name: files[name] for name in cameras}
    return make_scene(
        find_folder(files).name, cameras, posed_files, path, geometry_files(path), upright=True
    )


@lru_cache(maxsize=8)
def _cameras(
    path: Path, digest: str, stamped: tuple[tuple[str, Path, str], ...]
) -> Mapping[str, Camera]:
    """Return the cameras of photographs by name; cached by file contents."""
    stored, files = read_geometry(path), {name: file for name, file, _ in stamped}
    if stored.poses is None or stored.maps[0].K is None:
        raise InputError(
            f"{path}: holds no cameras; expected poses (extrinsics, poses) and intrinsics, or give "
            "others by --cameras"
        )
    numbers = stored.numbers(list(files))
    photos = {name: photograph(files[name], name) for name in numbers}
    if len(photos) < 2:
        raise InputError(f"{path}: has maps of {len(photos)} of the photographs, expected two")
    maps = [_Map(stored, number, photos[name]) for name, number in numbers.items()]
    first = maps[:TESTED_PHOTOGRAPHS]
    matches, sizes = _matches([entry.photo for entry in first])
    ways = max((entry.placements() for entry in first), key=len)
    # Intrinsics of the map before those of the photograph, and square pixels before others.
    sources = sorted(product(ways, (True, False)), key=lambda s: (not s[1], first[0].stretch(*s)))
    usual = "world-to-camera" if stored.inverted else "camera-to-world"
    poses = sorted(POSE_CONVENTIONS, key=lambda name: ("OpenGL" in name, usual not in name))
    readings: list[precomputed.Reading] = []
    problem: InputError | None = None
    for (way, of_map), pose, ray in product(sources, poses, (False, True)):
        try:
            cameras = [entry.camera(way, of_map, pose) for entry in first]
        except InputError as error:  # implausible intrinsics for this size
            problem = problem or error
            continue
        small = [camera.resize(*size) for camera, size in zip(cameras, sizes, strict=True)]
        depths = []
        for entry, camera in zip(first, small, strict=True):
            shrunk = np.diag(
                [entry.photo.width / camera.width, entry.photo.height / camera.height, 1.0]
            )
            depth, at = stored.maps[entry.number].depth, entry.place(way) @ shrunk
            z = precomputed.along_z(depth, at @ camera.K) if ray else depth
            depths.append(precomputed.z_at(z, at))
        readings.append(((way, of_map, pose), small, depths))
    if not readings:
        assert problem is not None
        raise problem
    (reading, _, _), fitted = precomputed.choose_reading(path, readings, matches)
    way, of_map, pose = reading
    if (way, of_map) != sources[0] or pose != poses[0]:
        warnings.warn(
            f"{path}: poses are read as {pose}, and intrinsics as of "
            f"{way if of_map else f'stored, not {way},'} photographs: so depth takes "
            f"{fitted.evidence}",
            stacklevel=2,
        )
    return {entry.photo.name: entry.camera(way, of_map, pose) for entry in maps}


@dataclass(frozen=True, eq=False)
class _Map:
    """A depth map of the file, by its number, and the photograph to which it belongs."""

    stored: GeometryFile
    number: int
    photo: Photograph

    def placements(self) -> dict[str, np.ndarray]:
        """Return the ways in which the map may cover the photograph."""
        height, width = self.stored.maps[self.number].depth.shape
        return precomputed.placements(width, height, (self.photo.width, self.photo.height))

    def place(self, way: str) -> np.ndarray:
        """Return the transform [3, 3] from pixels of the photograph to those of the map."""
        ways = self.placements()
        return ways.get(way, ways["stretched"])

    def intrinsics(self, way: str, of_map: bool) -> np.ndarray:
        """Return K [3, 3] of the photograph, where the file has that of the map or this."""
        K = self.stored.maps[self.number].K
        assert K is not None
        return np.linalg.inv(self.place(way)) @ K if of_map else K

    def stretch(self, way: str, of_map: bool) -> float:
        """Return the absolute logarithm of the pixels' aspect ratio, rounded."""
        K = self.intrinsics(way, of_map)
        return round(abs(float(np.log(max(K[0, 0] / K[1, 1], 1e-9)))), 2)

    def camera(self, way: str, of_map: bool, pose: str) -> Camera:
        """Return the camera of the photograph under one interpretation; InputError if invalid."""
        assert self.stored.poses is not None
        inverted, flipped = POSE_CONVENTIONS[pose]
        c2w = self.stored.poses[self.number]
        if not np.linalg.det(c2w):
            raise InputError(f"{self.stored.file}: pose {self.number} is singular, not a rigid one")
        c2w = np.linalg.inv(c2w) if inverted else c2w
        c2w = c2w @ FLIP_YZ if flipped else c2w
        K = self.intrinsics(way, of_map)
        camera = Camera(K, c2w, self.photo.width, self.photo.height)
        check_intrinsics(camera)
        return camera


def _matches(photos: Sequence[Photograph]) -> tuple[precomputed.Matches, list[tuple[int, int]]]:
    """Match successive photographs, scaled to the sizes (width, height) that are returned too."""
    scales = [TESTED_SIDE / max(photo.width, photo.height) for photo in photos]
    sizes = [(round(p.width * s), round(p.height * s)) for p, s in zip(photos, scales, strict=True)]
    features = []
    for photo, size in zip(photos, sizes, strict=True):
        image = cv2.resize(photo.image, size, interpolation=cv2.INTER_AREA)
        features.append(sift(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)))
    matches = {}
    for i, j in pairwise(range(len(photos))):
        a, b, _ = match(features[i], features[j], LOWE_RATIO)
        p, q = features[i].points[a], features[j].points[b]
        keep = agree(p, q, COARSE_DISTANCE * TESTED_SIDE)
        matches[i, j] = p[keep], q[keep]
    return matches, sizes
