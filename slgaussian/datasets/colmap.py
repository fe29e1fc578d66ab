"""COLMAP reconstructions: undistorted images and the cameras of the sparse model.

COLMAP's poses are world-to-camera with OpenCV axes, and its pixel centres lie at +0.5, as here
(https://colmap.github.io/format.html). pycolmap undistorts, so every camera model with a focal
length is supported; photographs without distortion do not need pycolmap.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
    SparseModel,
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
    the model with most images is read, with a warning.

    Views are named by their path below the folder of photographs, as in the model, and sorted by
    it. Undistorted views have the focal lengths and principal point of the lens, so intrinsics may
    differ between views; pixels outside the lens's image are black. If photographs were downscaled
    (all of one camera equally), the cameras are scaled too.

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
    named = {n: replace(i, name=name_in(folder, i.name)) for n, i in model.images.items()}
    model = replace(model, images=named)
    names: dict[str, int] = {}
    for number, image in sorted(model.images.items(), key=lambda item: item[1].name):
        if image.name in names:
            raise InputError(f"{source}: two images are called {image.name!r}; remove one")
        names[image.name] = number
    files = {name: _file(path, folder, name) for name in names}
    lenses = _lenses(source, model, files)
    ranges = _depth_ranges(model)
    cameras = {}
    for name, number in names.items():
        image = model.images[number]
        lens = lenses[image.camera]
        near, far = ranges.get(number, (None, None))
        c2w = np.eye(4)
        c2w[:3, :3] = image.w2c[:3, :3].T
        c2w[:3, 3] = -image.w2c[:3, :3].T @ image.w2c[:3, 3]
        try:
            cameras[name] = checked_camera(Camera(lens.K, c2w, *lens.size, near, far))
        except InputError as bad:
            raise InputError(f"{source}: image {name!r}: {bad}") from None
    if not cameras:
        raise InputError(f"{source}: has no posed image; reconstruct again")
    maps = {name: lenses[model.images[number].camera].maps for name, number in names.items()}
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
    parts = (place.parent if place.name.isdecimal() else place).parts
    above = [
        Path(*parts[: -len(inside)])
        for inside in (Path(inside).parts for inside in PLACES if inside != ".")
        if parts[-len(inside) :] == inside
    ]
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
            distorted = np.where(
                np.isfinite(distorted), distorted - 0.5, OUTSIDE
            )  # OpenCV's pixel centres
            maps[:, rows] = distorted.astype(np.float32).reshape(*u.shape, 2).transpose(2, 0, 1)
        return maps[0], maps[1]


def _lenses(source: Path, model: SparseModel, files: Mapping[str, Path]) -> dict[int, _Lens]:
    """Return the lens of each camera, at the size of its first existing photograph."""
    first: dict[int, Path | None] = {}
    for image in sorted(model.images.values(), key=lambda image: image.name):
        if first.get(image.camera) is None:
            file = files[image.name]
            first[image.camera] = file if is_there(file) else None
    lenses = {}
    for number, photograph in first.items():
        stored = model.cameras[number]
        K, straight = _pinhole(stored, f"{source}: camera {number}")
        full_size = (stored.width, stored.height)
        size = None if photograph is None else stored_size(photograph, full_size)
        if size is None or not has_shape(size, full_size):  # else it was shrunk
            size = full_size
        scale = np.array([size[0] / full_size[0], size[1] / full_size[1], 1])
        lenses[number] = _Lens(stored, size, scale[:, None] * K, straight)
    return lenses


def _pinhole(camera: SparseCamera, label: str) -> tuple[np.ndarray, bool]:
    """Return the intrinsics [3, 3] of the undistorted view, and whether the lens is a pinhole."""
    if camera.model in ("PINHOLE", "SIMPLE_PINHOLE"):
        fx, fy, cx, cy = (
            camera.params if len(camera.params) == 4 else camera.params[:1] + camera.params
        )
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), True
    lens = _pycolmap_camera(camera)
    if not len(lens.focal_length_idxs()):
        raise InputError(
            f"{label}: its model {camera.model} has no focal length, so it cannot be undistorted "
            "to a pinhole camera; cut its images into pinhole images and reconstruct again"
        )
    K = lens.calibration_matrix()
    if not (K[0, 0] > 0 and K[1, 1] > 0 and abs(np.linalg.det(K)) > 0 and np.isfinite(K).all()):
        raise InputError(
            f"{label}: its focal lengths are {K[0, 0]:g} and {K[1, 1]:g}, expected positive "
            "numbers; reconstruct again"
        )
    corners = np.array([(u, v, 1.0) for u in (0, camera.width) for v in (0, camera.height)])
    rays = corners @ np.linalg.inv(K).T
    # pycolmap reports a fisheye with zero distortion as undistorted, but it is not a pinhole.
    return K, np.allclose(lens.img_from_cam(rays), corners[:, :2], rtol=0, atol=1e-6)


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


def _depth_ranges(model: SparseModel) -> dict[int, tuple[float, float]]:
    """Compute near and far of the images with enough points, by id; see :func:`read`."""
    observations = np.unique(model.sightings, axis=0)  # an image may show a point twice
    lengths = np.bincount(observations[:, 0], minlength=len(model.points))
    observations = observations[lengths[observations[:, 0]] >= TRACK]
    observations = observations[np.argsort(observations[:, 1], kind="stable")]
    starts = np.flatnonzero(np.diff(observations[:, 1], prepend=-1))
    ranges = {}
    for sightings in np.split(observations, starts[1:]):
        image = model.images.get(int(sightings[0, 1])) if len(sightings) else None
        if image is None:
            continue
        depths = np.sort(model.points[sightings[:, 0]] @ image.w2c[2, :3] + image.w2c[2, 3])
        depths = depths[depths > 0]
        if len(depths) >= POINTS:
            ranges[int(sightings[0, 1])] = (
                0.8 * float(depths[2]),
                2 * float(np.percentile(depths, 98)),
            )
    return ranges
