"""COLMAP reconstructions: undistorted images and the cameras of the sparse model.

COLMAP's poses are world-to-camera with OpenCV axes, and its pixel centres lie at +0.5, as here
(https://colmap.github.io/format.html). Camera models are supported that OpenCV has too.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from slgaussian.datasets.lens import Maps, checked_camera, lens_maps
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
from slgaussian.scene import Camera, Scene

PLACES = ("sparse", "colmap/sparse", ".")
"""Folders of the model, or of models in subfolders 0, 1, ..., relative to the scene's folder."""


def read(path: str | Path, images: str | None = None) -> Scene:
    """Read a scene; photographs are opened and undistorted when a view is read.

    If there are several models (COLMAP writes one for each group of images that it cannot connect),
    the model with most images is read, with a warning. Views are named by their path below the
    folder of photographs, as in the model, and sorted by it. Undistorted views have the focal
    lengths and principal point of the lens; pixels outside the lens's image are black. If
    photographs were downscaled (all of one camera equally), the cameras are scaled too.

    Args:
        path: Folder of the scene, with the model in ``sparse/0``, ``sparse`` or itself; or the
            folder of one model.
        images: Subfolder of the photographs; default ``images``, or the largest of ``images_2`` and
            so on.

    Raises:
        InputError: If there is no model, a file of it is damaged, or a camera model is not
            supported. A missing or unreadable photograph is an error only when its view is read.
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
    stored_cameras, stored_images = read_model(source)
    if not stored_images:
        raise InputError(f"{source}: has no posed image; reconstruct again")
    posed = {}
    for image in stored_images:
        name = name_in(folder, image.name)
        if name in posed:
            raise InputError(f"{source}: two images are called {name!r}; remove one")
        posed[name] = image
    files = {name: _file(path, folder, name) for name in sorted(posed)}
    lenses, cameras, maps = {}, {}, {}
    for number, stored in stored_cameras.items():
        taken = [files[name] for name in files if posed[name].camera == number]
        if taken:
            existing = next(filter(is_there, taken), None)
            lenses[number] = _lens(stored, existing)
    for name in files:
        K, size, lens = lenses[posed[name].camera]
        if lens is not None:
            maps[name] = lens
        try:
            cameras[name] = checked_camera(Camera(K, np.linalg.inv(posed[name].w2c), *size))
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


def _lens(
    stored: SparseCamera, photograph: Path | None
) -> tuple[np.ndarray, tuple[int, int], Callable[[], Maps] | None]:
    """Return K, size and undistortion of a camera, at the size of one of its photographs."""
    focals = 1 if "SIMPLE" in stored.model or "RADIAL" in stored.model else 2
    (cx, cy), distortion = stored.params[focals : focals + 2], stored.params[focals + 2 :]
    K = np.array([[stored.params[0], 0, cx], [0, stored.params[focals - 1], cy], [0, 0, 1]])
    full_size = (stored.width, stored.height)
    size = None if photograph is None else stored_size(photograph, full_size)
    if size is None or not has_shape(size, full_size):  # else it was shrunk
        size = full_size
    K[:2] *= np.array([[size[0] / full_size[0]], [size[1] / full_size[1]]])
    fisheye = "FISHEYE" in stored.model
    is_pinhole = not fisheye and not any(distortion)
    return K, size, None if is_pinhole else partial(lens_maps, K, size, distortion, fisheye)
