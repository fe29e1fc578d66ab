"""Cameras from an NPZ of geometry, as written by Depth Anything 3 and users of VGGT or DUSt3R.

Such a file does not state whether its poses are world-to-camera, nor whether its intrinsics belong
to the stored photographs or to the stretched, cropped or padded input of the network. The reader
selects the interpretation that agrees with the depth and with feature matches, as
:mod:`slgaussian.predict.precomputed` does.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import pairwise, product
from pathlib import Path

import cv2
import numpy as np

from slgaussian.cameras.check import COARSE, agree
from slgaussian.cameras.matches import LOWE_RATIO, match, sift
from slgaussian.cameras.two_view import Photograph
from slgaussian.datasets.intrinsics import checked_camera
from slgaussian.datasets.photographs import scene_of
from slgaussian.datasets.unposed import folder_of, named, photograph
from slgaussian.errors import InputError
from slgaussian.formats.depth_maps import GeometryFile, read_geometry
from slgaussian.io import file_digest
from slgaussian.predict import precomputed
from slgaussian.scene import Camera, Scene

JUDGED = 6
"""Number of photographs, the first, by which the interpretation is selected."""

LONGEST = 640
"""Longer side of these photographs, pixels."""

POSES = {
    "camera-to-world in OpenCV's axes": (False, False),
    "world-to-camera in OpenCV's axes": (True, False),
    "camera-to-world in OpenGL's axes": (False, True),
    "world-to-camera in OpenGL's axes": (True, True),
}
"""Whether to invert the poses, and then to reverse y and z, by convention."""

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def read(path: str | Path, photographs: str | Sequence[str] | None = None) -> Scene:
    """Read a scene of photographs with the cameras of an NPZ.

    Args:
        path: NPZ, see :data:`slgaussian.formats.depth_maps.KEYS`.
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
    files = named(photographs)
    stamped = tuple((name, file, file_digest(file)) for name, file in files.items())
    cameras = _cameras(path, file_digest(path), stamped)
    posed_files = {name: files[name] for name in cameras}
    return scene_of(folder_of(files).name, cameras, posed_files, path, [path], upright=True)


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
    first = dict(list(photos.items())[:JUDGED])
    matches, sizes = _matches(list(first.values()))
    readings: list[precomputed.Reading] = []
    usual = "world-to-camera" if stored.inverted else "camera-to-world"
    poses = sorted(POSES, key=lambda name: ("OpenGL" in name, usual not in name))
    ways = _ways(stored, numbers, first)
    for way, pose, ray in product(ways, poses, (False, True)):
        try:
            cameras = _cameras_of(stored, numbers, first, ways[way], pose)
        except InputError:  # implausible intrinsics for this size
            continue
        small = [
            camera.resized(*size) for camera, size in zip(cameras.values(), sizes, strict=True)
        ]
        depths = []
        for name, camera in zip(first, small, strict=True):
            photo = first[name]
            shrunk = np.diag([photo.width / camera.width, photo.height / camera.height, 1.0])
            at, depth = ways[way][0][name] @ shrunk, stored.maps[numbers[name]].depth
            depths.append(precomputed.z_at(depth, at, camera, ray))
        readings.append(((way, pose), small, depths))
    if not readings:
        _cameras_of(
            stored, numbers, first, next(iter(ways.values())), poses[0]
        )  # raises for implausible intrinsics
    ((way, pose), _, _), fitted = precomputed.choose_reading(path, readings, matches)
    if pose != poses[0] or way != next(iter(ways)):
        warnings.warn(
            f"{path}: poses are read as {pose}, and intrinsics as of {way} photographs: so depth "
            f"takes {fitted.share:.0%} of the matches to where the other view shows them",
            stacklevel=2,
        )
    ways = _ways(stored, numbers, photos)
    return _cameras_of(stored, numbers, photos, ways[way], pose)


def _matches(photos: Sequence[Photograph]) -> tuple[precomputed.Matches, list[tuple[int, int]]]:
    """Match successive photographs, scaled to the sizes (width, height) that are returned too."""
    scales = [LONGEST / max(photo.width, photo.height) for photo in photos]
    sizes = [(round(p.width * s), round(p.height * s)) for p, s in zip(photos, scales, strict=True)]
    greys = [
        cv2.cvtColor(cv2.resize(p.image, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)
        for p, size in zip(photos, sizes, strict=True)
    ]
    features = [sift(grey) for grey in greys]
    matches = {}
    for i, j in pairwise(range(len(photos))):
        a, b, _ = match(features[i], features[j], LOWE_RATIO)
        p, q = features[i].points[a], features[j].points[b]
        keep = agree(p, q, COARSE * LONGEST)
        matches[i, j] = p[keep], q[keep]
    return matches, sizes


Way = tuple[dict[str, np.ndarray], bool]
"""Transform from photograph pixels to map pixels, and whether the intrinsics belong to the map."""


def _ways(
    stored: GeometryFile, numbers: Mapping[str, int], photos: Mapping[str, Photograph]
) -> dict[str, Way]:
    """List the possible preprocessings of the photographs, those with square pixels first."""
    placed = {}
    for name, photo in photos.items():
        height, width = stored.maps[numbers[name]].depth.shape
        placed[name] = precomputed.placements(width, height, (photo.width, photo.height))
    ways: dict[str, Way] = {}
    for way in max(placed.values(), key=len):
        at = {name: ways.get(way, ways["stretched"]) for name, ways in placed.items()}
        ways[way] = at, True
        ways[f"stored, not {way},"] = at, False
    K = stored.maps[next(iter(numbers.values()))].K
    assert K is not None

    def stretch(way: str) -> float:
        at, of_map = ways[way]
        focal = (np.linalg.inv(next(iter(at.values()))) @ K if of_map else K)[[0, 1], [0, 1]]
        return round(abs(float(np.log(max(focal[0] / focal[1], 1e-9)))), 2)

    return {
        way: ways[way] for way in sorted(ways, key=lambda way: (not ways[way][1], stretch(way)))
    }


def _cameras_of(
    stored: GeometryFile,
    numbers: Mapping[str, int],
    photos: Mapping[str, Photograph],
    way: Way,
    pose: str,
) -> dict[str, Camera]:
    """Return the cameras of whole photographs under one interpretation; InputError if invalid."""
    inverted, flipped = POSES[pose]
    cameras = {}
    for name, photo in photos.items():
        K = stored.maps[numbers[name]].K
        assert K is not None and stored.poses is not None
        c2w = stored.poses[numbers[name]]
        K = np.linalg.inv(way[0][name]) @ K if way[1] else K
        c2w = np.linalg.inv(c2w) if inverted else c2w
        c2w = c2w @ FLIP if flipped else c2w
        cameras[name] = checked_camera(Camera(K, c2w, photo.width, photo.height))
    return cameras
