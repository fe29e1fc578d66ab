"""Scenes of photographs without cameras, which are estimated.

Photographs are turned upright by their EXIF orientation. The world is the frame of the first
camera, and its unit the distance of the first two cameras (:mod:`slgaussian.cameras.estimated`);
the photographs of a folder are in natural order (:mod:`slgaussian.checks`).
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from slgaussian.cameras.estimated import EstimatedCameras
from slgaussian.cameras.find import find_cameras
from slgaussian.cameras.two_view import MAX_IMAGE_SIDE, Photograph
from slgaussian.checks import order_naturally
from slgaussian.datasets.exif import SIDEWAYS_ORIENTATIONS, read_lens, read_orientation, upright
from slgaussian.datasets.lens import undistort
from slgaussian.datasets.photographs import (
    Mask,
    composite,
    find_masks,
    list_photographs,
    make_scene,
    rgb,
    skip_unreadable,
)
from slgaussian.errors import InputError
from slgaussian.formats.images import open_image, unreadable
from slgaussian.io import file_digest
from slgaussian.scene import Sample, Scene, Size, View

Place = str | Path

FILMS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mpg", ".mts", ".3gp", ".wmv")
RAW_FILES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2")
"""Suffixes of films and of raw files, which are no photographs."""


def photographs(
    *images: Any, size: Size = "auto", near: float | None = None, far: float | None = None
) -> Sample:
    """Make a sample of photographs, or folders of them, and estimate their cameras.

    Args:
        *images: path, uint8 [H, W, 3] or PIL image; or one list of them. All become context views,
            in this order; those of a folder by name. Images in memory are named ``image_0``,
            ``image_1``, ....
        size: (height, width), "at most 312x432", "auto" or "original"
        near, far: Depth range; it and ``size`` are as in :meth:`slgaussian.scene.Scene.sample`. The
            unit is the distance of the first two cameras.

    Raises:
        InputError: If a file cannot be read, or the cameras cannot be estimated; the message gives
            the reason and what to do.
    """
    if len(images) == 1 and isinstance(images[0], list | tuple):
        images = tuple(images[0])
    scene = read(images) if all(isinstance(i, Place) for i in images) else _in_memory(images)
    return scene.sample(list(scene.cameras), size=size, near=near, far=far)


def _in_memory(images: Sequence[Any]) -> Scene:
    """Estimate the cameras of images in memory; PIL images may have EXIF."""
    pictures = {}
    for i, image in enumerate(images):
        if isinstance(image, np.ndarray) and image.dtype == np.uint8 and image.shape[2:] == (3,):
            image = Image.fromarray(image)
        if not isinstance(image, Image.Image):
            dtype = f" of {image.dtype} {image.shape}" if isinstance(image, np.ndarray) else ""
            raise InputError(
                f"photographs: image {i} is a {type(image).__name__}{dtype}; expected paths alone, "
                "or images in memory alone: uint8 arrays [H, W, 3] or PIL images"
            )
        image.load()
        pictures[f"image_{i}"] = image
    if len(pictures) < 2:
        raise InputError(f"photographs: found {len(pictures)} image, expected at least two")
    estimated = find_cameras([_photograph(image, name) for name, image in pictures.items()])
    lenses = estimated.lenses()

    def read_view(name: str) -> View:
        pixels = rgb(upright(pictures[name], read_orientation(pictures[name])), name)
        view = View(name, estimated.cameras[name], pixels)
        return undistort(view, lenses[name]()) if name in lenses else view

    record = estimated.as_json()
    return Scene(
        "images", estimated.cameras, read_view, estimation=record, matches=estimated.matches
    )


def read(path: Place | Sequence[Place], only: Sequence[str] | None = None) -> Scene:
    """Read a scene of photographs by their names; the cameras of all are estimated together.

    The estimation is cached in the process by the photographs and their order.

    Args:
        path: path or sequence of path. A folder of photographs, in itself or below ``images``; or
            files and folders.
        only: sequence of str, optional. Photographs of that folder to use, by their paths below it,
            in this order.

    Raises:
        InputError: As :func:`photographs`.
    """
    listed = _list_files(path, only)
    return read_with_cameras(listed, find(listed))


def files(path: Place | Sequence[Place], only: Sequence[str] | None = None) -> list[Path]:
    """List the photographs of a scene, all of which influence the estimated cameras."""
    listed = _list_files(path, only)
    return [*listed.values(), *(mask.file for mask in find_masks(listed).values())]


def _list_files(path: Place | Sequence[Place], only: Sequence[str] | None) -> dict[str, Path]:
    places = [path] if isinstance(path, Place) else path
    return name_files(places if only is None else [Path(places[0]) / name for name in only])


def name_files(places: Sequence[Place]) -> dict[str, Path]:
    """List the photographs at files and folders, by their path below the common folder.

    Those in the order of letters, as in a folder or from a shell, are put in natural order. Of a
    folder, files that cannot be read and thumbnails are left out with a warning.

    Raises:
        InputError: If a folder has none, there are fewer than two, one is listed twice, or a film
            or raw file is given.
    """
    listed: list[Path] = []
    for place in map(Path, places):
        inside = skip_unreadable(list_photographs(place)) if place.is_dir() else [place]
        for file in inside or sorted(place.iterdir()):
            _check_kind(file)
        if not inside:
            raise InputError(
                f"{place}: holds no photographs; expected files such as .jpg or .png there, or "
                "below images"
            )
        listed += inside
    absolute = [Path(os.path.abspath(file)) for file in listed]
    if repeated := [str(file) for i, file in enumerate(absolute) if file in absolute[:i]]:
        raise InputError(f"{repeated[0]}: is given twice; give each photograph once")
    if len(listed) < 2:
        raise InputError(
            f"photographs: found {', '.join(map(str, listed)) or 'nothing'}, expected at least "
            "two; add a photograph of the same things from a step aside"
        )
    folder = find_folder(dict(enumerate(absolute)))
    names = [file.relative_to(folder).as_posix() for file in absolute]
    by_name = dict(zip(names, listed, strict=True))
    return {name: by_name[name] for name in order_naturally(names)}


def _check_kind(file: Path) -> None:
    """Raise InputError for a film or raw file; the picture in a raw file is a small preview."""
    if file.suffix.lower() in FILMS:
        frames = shlex.quote(f"{file.stem}_%04d.jpg")
        raise InputError(
            f"{file}: is a film; take photographs out of it, such as two a second, with "
            f"`ffmpeg -i {shlex.quote(str(file))} -vf fps=2 -q:v 2 {frames}`, and give those"
        )
    if file.suffix.lower() in RAW_FILES:
        raise InputError(f"{file}: is a raw file of a camera; develop it and save it as JPEG")


def find_folder(files: Mapping[Any, Path]) -> Path:
    """Return the absolute path of the folder relative to which photographs are named."""
    return Path(os.path.commonpath([os.path.abspath(file.parent) for file in files.values()]))


def find(files: Mapping[str, Path]) -> EstimatedCameras:
    """Estimate the cameras of photographs by name, cached by the files and their order."""
    masks = find_masks(files)
    try:
        stamped = [(n, str(file), file_digest(file), masks.get(n)) for n, file in files.items()]
        digests = [file_digest(mask.file) for mask in masks.values()]
    except OSError as bad:
        raise InputError(
            f"{bad.filename}: cannot be read ({bad.strerror}); give the files of photographs"
        ) from None
    return _find(tuple(stamped), tuple(digests))


@lru_cache(maxsize=8)
def _find(
    files: tuple[tuple[str, str, str, Mask | None], ...], masks: tuple[str, ...]
) -> EstimatedCameras:
    return find_cameras([photograph(Path(file), name, mask) for name, file, _, mask in files])


def photograph(file: Path, name: str, mask: Mask | None = None) -> Photograph:
    """Read a photograph for the estimation of cameras: upright, downscaled, with its EXIF lens.

    What the mask leaves out is black.
    """
    try:
        with open_image(file) as image:
            if image.format == "TIFF":
                image.load()  # Pillow rotates the pixels of a TIFF while loading
            return _photograph(image, name, mask)
    except InputError:
        raise
    except (OSError, ValueError) as bad:
        raise unreadable(file, bad) from None


def _photograph(image: Image.Image, name: str, mask: Mask | None = None) -> Photograph:
    full_size, (lens, focal) = image.size, read_lens(image)
    orientation = read_orientation(image)
    scale = min(1.0, MAX_IMAGE_SIDE / max(full_size))
    small_size = max(1, round(full_size[0] * scale)), max(1, round(full_size[1] * scale))
    # A JPEG is decoded at a half, a quarter or an eighth of its size, to save time and memory.
    image.draft("RGB", small_size)
    part = max(1, round(full_size[0] / image.size[0]))
    covered = (0.0, 0.0, full_size[0] / part, full_size[1] / part)  # without padded pixels
    plain = image if image.mode == "RGB" else Image.fromarray(rgb(image, name))
    small = plain.resize(small_size, Image.Resampling.BICUBIC, covered)
    pixels = rgb(upright(small, orientation), name)
    if mask is not None:
        pixels = composite(pixels, mask.read_alpha(*pixels.shape[1::-1]))
    width, height = full_size[::-1] if orientation in SIDEWAYS_ORIENTATIONS else full_size
    return Photograph(name, pixels, width, height, lens, focal)


def read_with_cameras(files: Mapping[str, Path], estimated: EstimatedCameras) -> Scene:
    """Return the scene of photographs by name with their estimated cameras."""
    name, record = find_folder(files).name or "photographs", estimated.as_json()
    scene = make_scene(
        name, estimated.cameras, files, "photographs", lenses=estimated.lenses(), upright=True,
        estimation=record,
    )  # fmt: skip
    return replace(scene, matches=estimated.matches)
