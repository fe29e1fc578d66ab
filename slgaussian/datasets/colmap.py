"""COLMAP reconstructions: undistorted images and the cameras of the sparse model.

COLMAP's poses are world-to-camera with OpenCV axes, and its pixel centres lie at +0.5, as here
(https://colmap.github.io/format.html). pycolmap undistorts, so every camera model with a focal
length is supported; photographs without distortion do not need pycolmap.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian.datasets.intrinsics import checked_camera
from slgaussian.datasets.lens import OUTSIDE, Maps
from slgaussian.datasets.photographs import (
    EXTENSIONS,
    has_shape,
    image_folder,
    is_there,
    name_in,
    scene_of,
    stored_size,
)
from slgaussian.datasets.sparse import (
    SparseCamera,
    count_images,
    model_files,
    read_model,
)
from slgaussian.errors import InputError
from slgaussian.extras import install_line
from slgaussian.scene import Camera, Scene

PLACES = ("sparse", "colmap/sparse", ".")
"""Folders of the model, or of models in subfolders 0, 1, ..., relative to the scene's folder."""

TRACK = 3
"""Smallest number of images that must show a point for its depth to be used."""

POINTS = 12
"""Smallest number of such points for the depth range of an image."""

ROWS = 64
"""Rows of an undistortion map computed at a time, in float64."""


def read(path: str | Path, images: str | None = None) -> Scene:
    """Read a scene; photographs are opened and undistorted when a view is read.

    If there are several models (COLMAP writes one for each group of images that it cannot connect),
    the model with most images is read, with a warning. Views are named by their path below the
    folder of photographs, as in the model, and sorted by it. Undistorted views have the focal
    lengths and principal point of the lens; pixels outside the lens's image are black. If
    photographs were downscaled (all of one camera equally), the cameras are scaled too.

    ``near`` and ``far`` of a camera are 0.8 times the depth of its third nearest point and twice
    the 98th percentile, if it has enough points, because points lie on texture, not on the nearest
    or farthest surface.

    Args:
        path: Folder of the scene, with the model in ``sparse/0``, ``sparse`` or itself; or the
            folder of one model.
        images: Subfolder of the photographs; default ``images``, or the largest of ``images_2`` and
            so on.

    Raises:
        InputError: If there is no model, a file of it is damaged, a camera model has no focal
            length, or pycolmap is needed and not installed. A missing or unreadable photograph is
            an error only when its view is read.
    """
    path = Path(path)
    models = models_in(path)
    source = largest(models) if models else path / PLACES[0] / "0"
    if len(models) > 1:
        sizes = ", ".join(f"{count_images(place)} in {place.name}" for place in models)
        warnings.warn(
            f"{source.parent}: has several models ({sizes} images), of which {source.name} is "
            f"taken; give the folder of another one to take that",
            stacklevel=2,
        )
    path = scene_folder(path)
    folder = image_folder(path, images)
    model = read_model(source)
    if not model.images:
        raise InputError(f"{source}: has no posed image; reconstruct again")
    numbers = {name_in(folder, image.name): number for number, image in model.images.items()}
    files = {name: _file(path, folder, name) for name in sorted(numbers)}
    observations = np.unique(model.sightings, axis=0)  # an image may show a point twice
    lengths = np.bincount(observations[:, 0], minlength=len(model.points))
    observations = observations[lengths[observations[:, 0]] >= TRACK]
    lenses = {}
    for number, stored in model.cameras.items():
        taken = [n for n in files if model.images[numbers[n]].camera == number]
        existing = next((files[name] for name in taken if is_there(files[name])), None)
        if taken:
            lenses[number] = _lens(stored, existing, f"{source}: camera {number}")
    cameras, maps = {}, {}
    for name in files:
        image = model.images[numbers[name]]
        lens = lenses[image.camera]
        maps[name] = lens.maps
        points = model.points[observations[observations[:, 1] == numbers[name], 0]]
        depths = np.sort(points @ image.w2c[2, :3] + image.w2c[2, 3])
        depths = depths[depths > 0]
        near = far = None
        if len(depths) >= POINTS:
            near, far = 0.8 * float(depths[2]), 2 * float(np.percentile(depths, 98))
        try:
            c2w = np.linalg.inv(image.w2c)
            cameras[name] = checked_camera(Camera(lens.K, c2w, *lens.size, near, far))
        except InputError as bad:
            raise InputError(f"{source}: image {name!r}: {bad}") from None
    name = path.resolve().name or "scene"
    return scene_of(name, cameras, files, source, model_files(source), maps)


def models_in(path: Path) -> list[Path]:
    """List the folders of the models of a scene by number; empty if there is no model."""
    for place in (path / place for place in PLACES):
        numbered = [f for f in place.glob("*") if f.name.isdecimal() and model_files(f)]
        if numbered or model_files(place):
            return sorted(numbered, key=lambda folder: int(folder.name)) or [place]
    return []


def largest(models: Sequence[Path]) -> Path:
    """Return the model with most images, the first in a tie."""
    return models[0] if len(models) == 1 else max(models, key=count_images)


def scene_folder(path: Path) -> Path:
    """Return the folder of the scene that contains a model or a folder of models; else ``path``.

    If two folders are possible, as above ``colmap/sparse``, the one with photographs is returned.
    """
    place = Path(os.path.abspath(path))
    model = place.parent if place.name.isdecimal() else place
    above = [f for f in model.parents[:2] if any(f / inside == model for inside in PLACES)]
    with_images = (folder for folder in above if image_folder(folder).is_dir())
    return next(with_images, above[-1] if above else path)


def _file(scene: Path, folder: Path, name: str) -> Path:
    """Return the path of a photograph, which may be missing."""
    # Some tools write downscaled photographs with another extension.
    for start in (folder / name, scene / name):
        alternatives = (start.with_suffix(end) for end in EXTENSIONS) if start.name else ()
        for file in (start, *alternatives):
            if is_there(file):
                return file
    return folder / name


@dataclass(frozen=True, eq=False)
class _Lens:
    """A camera of the model, whose photographs are stored at ``size`` (width, height)."""

    stored: SparseCamera
    size: tuple[int, int]
    K: np.ndarray
    straight: bool

    def maps(self) -> Maps | None:
        """Compute undistortion maps (:mod:`slgaussian.datasets.lens`); None for a pinhole."""
        if self.straight:
            return None
        width, height = self.size
        lens, inverse = _pycolmap_camera(self.stored), np.linalg.inv(self.K).T
        maps = np.empty((2, height, width), np.float32)
        for top in range(0, height, ROWS):
            rows = np.arange(top, min(top + ROWS, height))
            u, v = np.meshgrid(np.arange(width) + 0.5, rows + 0.5)
            rays = np.stack([u, v, np.ones_like(u)], -1).reshape(-1, 3) @ inverse
            distorted = lens.img_from_cam(rays)
            distorted *= (width / self.stored.width, height / self.stored.height)
            # OpenCV has pixel centres at integers.
            distorted = np.where(np.isfinite(distorted), distorted - 0.5, OUTSIDE)
            maps[:, rows] = distorted.astype(np.float32).reshape(*u.shape, 2).transpose(2, 0, 1)
        return maps[0], maps[1]


def _lens(stored: SparseCamera, photograph: Path | None, label: str) -> _Lens:
    """Return the lens of a camera, at the size of one of its photographs."""
    if stored.model in ("PINHOLE", "SIMPLE_PINHOLE"):
        fx, fy, cx, cy = stored.params[0], *stored.params[-3:]
        K, straight = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), True
    else:
        lens = _pycolmap_camera(stored)
        if not len(lens.focal_length_idxs()):
            raise InputError(
                f"{label}: its model {stored.model} has no focal length, so it cannot be "
                "undistorted to a pinhole camera; cut its images into pinhole images and "
                "reconstruct again"
            )
        K = lens.calibration_matrix()
        corners = [(u, v, 1.0) for u in (0, stored.width) for v in (0, stored.height)]
        try:
            rays = np.array(corners) @ np.linalg.inv(K).T
        except np.linalg.LinAlgError:
            raise InputError(f"{label}: its focal length is 0; reconstruct again") from None
        # pycolmap reports a fisheye with zero distortion as undistorted, but it is not a pinhole.
        distorted = lens.img_from_cam(rays)
        straight = np.allclose(distorted, np.array(corners)[:, :2], rtol=0, atol=1e-6)
    full_size = (stored.width, stored.height)
    size = None if photograph is None else stored_size(photograph, full_size)
    if size is None or not has_shape(size, full_size):  # else it was shrunk
        size = full_size
    scale = np.array([size[0] / full_size[0], size[1] / full_size[1], 1])
    return _Lens(stored, size, scale[:, None] * K, straight)


def _pycolmap_camera(camera: SparseCamera) -> Any:
    try:
        import pycolmap
    except ImportError:
        raise InputError(
            f"the camera model {camera.model} is distorted, and pycolmap, which knows it, is not "
            f"installed; install it with {install_line('colmap')}"
        ) from None
    try:
        return pycolmap.Camera(
            model=camera.model, width=camera.width, height=camera.height, params=camera.params
        )
    except (RuntimeError, ValueError):
        raise InputError(
            f"the camera model {camera.model} is not known to pycolmap {pycolmap.__version__}; "
            f"install another with {install_line('colmap')}"
        ) from None
