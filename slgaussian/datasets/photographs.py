"""Files of photographs of any kind: their pixels as the RGB uint8 that views hold."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from slgaussian.datasets.lens import Maps, straightened
from slgaussian.errors import InputError
from slgaussian.scene import Camera, View

EXTENSIONS = (".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")
"""Of photographs, in the order in which they are tried where a name leaves its extension out."""


def rgb(image: Image.Image) -> np.ndarray:
    """Pixels of an opened image as uint8 [H, W, 3], transparent ones over black.

    Grey is repeated, 16 bits are scaled. ValueError for floating-point pixels.
    """
    if image.mode.startswith("I"):  # 16 bits of grey
        grey = np.clip(np.asarray(image, np.float64) / 257, 0, 255)
        return np.repeat(np.round(grey).astype(np.uint8)[..., None], 3, axis=-1)
    if image.mode == "F":
        raise ValueError("floating-point pixels")
    if "A" in image.getbands() or "transparency" in image.info:
        pixels = np.asarray(image.convert("RGBA"), np.float64)
        return np.round(pixels[..., :3] * pixels[..., 3:] / 255).astype(np.uint8)
    return np.ascontiguousarray(np.asarray(image.convert("RGB")))


def open_rgb(path: Path) -> np.ndarray:
    """Pixels of a file as uint8 [H, W, 3], as :func:`rgb` gives them; InputError if damaged.

    An EXIF orientation is not applied, as poses and intrinsics belong to the stored pixels.
    """
    try:
        with Image.open(path) as image:
            image.load()
            return rgb(image)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as bad:
        raise unreadable(path, bad) from None


def stored_size(path: Path) -> tuple[int, int] | None:
    """Width and height of a stored photograph, None if it cannot be opened."""
    try:
        with Image.open(path) as image:
            return image.size
    except (OSError, Image.DecompressionBombError):
        return None


def photographs_in(folder: Path) -> list[Path]:
    """The photographs that lie in a folder, sorted by name; none if there is no such folder."""
    if not folder.is_dir():
        return []
    return sorted(path for path in folder.iterdir() if path.suffix in EXTENSIONS)


def image_folder(scene: Path, name: str | None = None) -> Path:
    """Where the photographs of a scene lie: ``images``, or of ``images_2`` ... the least shrunk.

    ``name`` says which instead. The folder may not be there, for the caller to say.
    """
    if name is not None:
        return scene / name
    whole = scene / "images"
    shrunk = [path for path in scene.glob("images_*") if path.name[7:].isdecimal()]
    if whole.is_dir() or not shrunk:
        return whole
    return min(shrunk, key=lambda path: int(path.name[7:]))


def posed_view(path: Path, name: str, camera: Camera, maps: Maps | None = None) -> View:
    """The view of a stored photograph, straightened if there are maps.

    Raises
    ------
    InputError
        If it cannot be read, or is not of its camera's size.
    """
    pixels = open_rgb(path)
    height, width = pixels.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            f"{path}: is {width}x{height}, but by its pose file {camera.width}x{camera.height}; "
            "bring it to that size and orientation"
        )
    if maps is not None:
        pixels, _ = straightened(pixels, None, maps)
    return View(name, camera, pixels)


def unreadable(path: Path, bad: Exception) -> InputError:
    """The error that says of a file that its content cannot be read, and why."""
    reason = str(bad).replace(str(path), "the file").strip(" .") or type(bad).__name__
    return InputError(
        f"{path}: cannot be read ({reason}); it is damaged or of another kind, save it again"
    )


def absent(path: Path, named_by: str, gone: Iterable[str], count: int) -> InputError:
    """The error that says of a photograph that it is not there, and how many others are not.

    ``named_by`` is the file that names it, ``gone`` the names of all that are missing, this one
    left out, and ``count`` how many photographs there should be.
    """
    others: Sequence[str] = list(gone)
    also = f" ({len(others)} more of its {count} photographs missing"
    also += f": {', '.join(others[:3])}{', ...' if len(others) > 3 else ''})" if others else ""
    return InputError(
        f"{path}: no such photograph, though {named_by} names it{also if others else ''}; put the "
        "file there or choose another view"
    )
