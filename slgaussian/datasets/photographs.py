"""Reading of photographs of any format as RGB uint8."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from slgaussian.datasets.exif import SIDEWAYS_ORIENTATIONS, orientation_of
from slgaussian.datasets.exif import upright as turned_upright
from slgaussian.datasets.lens import Maps, undistort
from slgaussian.errors import InputError
from slgaussian.formats.images import mask_levels, opened, unreadable
from slgaussian.scene import Camera, Scene, View

EXTENSIONS = (".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG", ".heic", ".HEIC")
"""Suffixes of photographs, tried in this order if a name has none."""

MIN_OPAQUE_ALPHA = 128  # smallest alpha, of 255, of an opaque pixel


def rgb(image: Image.Image) -> np.ndarray:
    """Return the pixels of an opened image, uint8 [H, W, 3], transparent ones over black.

    Grey is repeated, 16 bits are scaled. Raises ValueError for floating-point pixels.
    """
    if image.mode.startswith("I"):  # 16 bits of grey
        grey = np.round(np.clip(np.asarray(image) / 257, 0, 255)).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=-1)
    if image.mode == "F":
        raise ValueError("floating-point pixels")
    if "A" in image.getbands() or "transparency" in image.info:
        pixels = np.asarray(image.convert("RGBA"))
        return _over_black(pixels[..., :3], pixels[..., 3])
    return np.array(image if image.mode == "RGB" else image.convert("RGB"))


def _over_black(pixels: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Composite uint8 [H, W, 3] with alpha uint8 [H, W] over black, rounded."""
    return ((pixels * alpha[..., None].astype(np.uint16) + 127) // 255).astype(np.uint8)


def open_photograph(
    path: Path, size: tuple[int, int] | None = None, upright: bool = False
) -> tuple[np.ndarray, np.ndarray | None]:
    """Read the pixels of a file, see :func:`rgb`, and the opaque pixels, bool [H, W].

    The second is None if all are opaque; half transparent pixels count as transparent.

    Poses and intrinsics refer to the stored pixels with COLMAP, and to the upright image with other
    tools. ``size``, the camera's width and height, determines which: an EXIF orientation is applied
    only if the rotated photograph has this aspect and the stored one has not; with ``upright``,
    always.

    Raises:
        InputError: If the file is missing or damaged.
    """
    try:
        with opened(path) as image:
            turn = upright or _is_turned(image, size)
            image.load()
            oriented = turned_upright(image, orientation_of(image)) if turn else image
            pixels = rgb(oriented)
            if "A" not in oriented.getbands() and "transparency" not in image.info:
                return pixels, None
            opaque = np.asarray(oriented.convert("RGBA"))[..., 3] >= MIN_OPAQUE_ALPHA
    except (OSError, ValueError) as bad:
        raise unreadable(path, bad) from None
    return pixels, None if opaque.all() else opaque


def stored_size(path: Path, size: tuple[int, int] | None = None) -> tuple[int, int] | None:
    """Return width and height of an :func:`open_photograph`; None if it cannot be opened."""
    try:
        with opened(path) as image:
            return image.size[::-1] if _is_turned(image, size) else image.size
    except (OSError, ValueError):
        return None


def _is_turned(image: Image.Image, size: tuple[int, int] | None) -> bool:
    """Tell whether a camera of that size fits only the photograph rotated by its EXIF tag."""
    if size is None or orientation_of(image) not in SIDEWAYS_ORIENTATIONS:
        return False
    return not has_shape(image.size, size) and has_shape(image.size[::-1], size)


def has_shape(stored: tuple[int, int], size: tuple[float, float]) -> bool:
    """Tell whether two sizes (width, height) have one aspect ratio, up to whole pixels."""
    (w, h), (width, height) = stored, size
    return abs(w / width - h / height) <= 1 / width + 1 / height


def is_there(path: Path) -> bool:
    """Tell whether a file exists; invalid names, which camera files may contain, give False."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def name_in(folder: Path, name: str) -> str:
    """Return the name of a photograph below a folder, from a camera file, with slashes.

    Backslashes of Windows and surrounding blanks are part of the name only if such a file exists.
    """
    return name if is_there(folder / name) else name.strip(" \t").replace("\\", "/")


def photographs_in(folder: Path) -> list[Path]:
    """List the photographs in a folder, sorted by name; empty if the folder is missing."""
    if not folder.is_dir():
        return []
    return sorted(path for path in folder.iterdir() if path.suffix in EXTENSIONS)


def photographs_of(scene: Path) -> list[Path]:
    """List the photographs in a folder or, if it has none, in its :func:`image_folder`, by name."""
    return photographs_in(scene) or photographs_in(image_folder(scene))


def image_folder(scene: Path, name: str | None = None) -> Path:
    """Return a scene's folder of photographs: ``images``, or the largest of ``images_2`` etc.

    ``name`` overrides this. The folder may be missing; the caller reports it.
    """
    if name is not None:
        return scene / name
    full_size = scene / "images"
    shrunk = [path for path in scene.glob("images_*") if path.name[7:].isdecimal()]
    if full_size.is_dir() or not shrunk:
        return full_size
    return min(shrunk, key=lambda path: int(path.name[7:]))


def scene_of(
    name: str,
    cameras: Mapping[str, Camera],
    photographs: Mapping[str, Path],
    named_by: str | Path,
    files: Sequence[Path] = (),
    lenses: Mapping[str, Callable[[], Maps]] | None = None,
    upright: bool = False,
    estimation: Mapping[str, Any] | None = None,
) -> Scene:
    """Make a scene of stored photographs, which are opened and undistorted when they are read.

    Args:
        cameras, photographs: Cameras and photographs by view name; a photograph may be missing.
        named_by: File that lists the photographs, for messages.
        files: Files from which the cameras were read.
        lenses: Functions that compute the undistortion maps of views; pinholes are left out.
        upright: Whether the cameras refer to the upright photographs, see :func:`open_photograph`.
        estimation: Record of the estimation of the cameras.
    """
    views = {
        view: partial(open_view, view, camera, photographs[view], named_by, upright)
        for view, camera in cameras.items()
    }
    views |= {view: partial(views[view], lens=lens) for view, lens in (lenses or {}).items()}
    sources = {view: [*files, photograph] for view, photograph in photographs.items()}
    read = partial(read_view, views, named_by)
    return Scene(name, cameras, read, estimation=estimation or {}, sources=sources.__getitem__)


def read_view(views: Mapping[str, Callable[[], View]], named_by: str | Path, name: str) -> View:
    """Call the reader of a view by its name; InputError if there is none."""
    if name not in views:
        raise InputError(f"{named_by}: has no view {name!r}")
    return views[name]()


def open_view(
    name: str,
    camera: Camera,
    photograph: Path,
    named_by: str | Path,
    upright: bool = False,
    lens: Callable[[], Maps] | None = None,
    mask: Path | None = None,
    depth: np.ndarray | None = None,
) -> View:
    """Open a photograph as a view and undistort it; see :func:`scene_of`.

    ``mask`` is a second alpha channel: white where pixels are valid; values 0 and 1 are scaled.

    Raises:
        InputError: If a file is missing or damaged, or has another size than the camera.
    """
    if not is_there(photograph):
        raise InputError(
            f"{photograph}: no such photograph, though {named_by} names it; put the file there or "
            "choose another view"
        )
    pixels, opaque = open_photograph(photograph, (camera.width, camera.height), upright)
    height, width = pixels.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            f"{photograph}: is {width}x{height}, but {named_by} says {camera.width}x"
            f"{camera.height}; resize it or scale its camera"
        )
    if mask is not None:
        alpha = mask_levels(mask)
        if alpha.shape != (height, width):
            raise InputError(
                f"{mask}: has {alpha.shape} pixels, expected {height, width} as its photograph"
            )
        alpha = alpha * np.uint8(255) if alpha.max() == 1 else alpha
        visible = (alpha >= MIN_OPAQUE_ALPHA) & (True if opaque is None else opaque)
        pixels, opaque = _over_black(pixels, alpha), None if visible.all() else visible
    view = View(name, camera, pixels, depth, opaque=opaque)
    return view if lens is None else undistort(view, lens())
