"""Lens and orientation of a photograph, by the EXIF header of its file.

Tags and their meaning are those of CIPA DC-008, "Exchangeable image file format for digital still
cameras", and of ExifTool's tables (https://exiftool.org/TagNames/EXIF.html).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from PIL import ExifTags, Image

FILM_DIAGONAL = 43.27
"""Millimetres of the diagonal of 35 mm film, 36 x 24."""

WIDEST, LONGEST_FOCAL = 0.3, 20.0
"""Focal lengths out of this range, in units of the longer side, are no lens but a mistake."""

SENSOR_WIDTHS = 1.0, 100.0
"""Millimetres that a sensor may be wide; other focal plane resolutions are a mistake."""

UNITS = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
"""Millimetres in the units of a focal plane resolution."""

SIDEWAYS = (5, 6, 7, 8)
"""EXIF orientations whose upright photograph is as wide as the stored one is high."""

TRANSPOSED = dict(zip(range(2, 9), map(Image.Transpose, (0, 3, 1, 5, 4, 6, 2)), strict=True))
"""By EXIF orientation, what makes the upright photograph of the stored one."""


def orientation_of(image: Image.Image) -> int:
    """Return the EXIF orientation of an opened image, 1 to 8; 1 if it says none, or nonsense.

    Pillow turns TIFF itself when it loads the pixels: after that, it is 1.
    """
    try:
        stated = image.getexif().get(ExifTags.Base.Orientation, 1)
    except Exception:  # a damaged header raises almost anything
        return 1
    return stated if stated in range(1, 9) else 1


def upright(image: Image.Image, orientation: int) -> Image.Image:
    """Turn an image of an EXIF orientation; Pillow's own way chokes on other bad tags."""
    return image if orientation == 1 else image.transpose(TRANSPOSED[orientation])


def read_lens(image: Image.Image) -> tuple[str, float | None]:
    """Read lens and focal length of an opened image; nonsense counts as nothing.

    As :class:`slgaussian.cameras.two_view.Photograph` has them.
    """
    try:
        exif = image.getexif()
        base, exif_ifd = dict(exif), exif.get_ifd(ExifTags.IFD.Exif)
        return _lens_name(base, exif_ifd), _focal(exif_ifd, *image.size)
    except Exception:  # a damaged header raises almost anything, and the pixels may be good
        return "", None


def _lens_name(base: Mapping[int, Any], exif_ifd: Mapping[int, Any]) -> str:
    tags = ExifTags.Base
    named = [base.get(tags.Make), base.get(tags.Model), exif_ifd.get(tags.LensModel)]
    words = [" ".join(name.replace("\0", " ").split()) for name in named if isinstance(name, str)]
    lengths = {"mm": tags.FocalLength, "mm of 35": tags.FocalLengthIn35mmFilm}
    numbers = {unit: _number(exif_ifd.get(tag)) for unit, tag in lengths.items()}
    words += [f"{number:.4g} {unit}" for unit, number in numbers.items() if number]
    return ", ".join(filter(None, words))


def _focal(exif_ifd: Mapping[int, Any], width: int, height: int) -> float | None:
    """Return the focal length in pixels of a photograph of that size, upright or not."""
    tags = ExifTags.Base
    across, down = (_number(exif_ifd.get(t)) for t in (tags.ExifImageWidth, tags.ExifImageHeight))
    captured = (across, down) if across and down else (float(width), float(height))
    # A photograph of another shape than was taken is cropped: nobody knows where, and how shrunk.
    was, is_now = max(captured) / min(captured), max(width, height) / min(width, height)
    if abs(np.log(was / is_now)) > 0.01:
        return None
    film = _number(
        exif_ifd.get(tags.FocalLengthIn35mmFilm)
    )  # of the same angle; digital zoom is in it
    by_film = film * float(np.hypot(width, height)) / FILM_DIAGONAL if film else None
    for focal in (by_film, _focal_by_sensor(exif_ifd, captured, max(width, height))):
        if focal is not None and WIDEST <= focal / max(width, height) <= LONGEST_FOCAL:
            return focal
    return None


def _focal_by_sensor(
    exif_ifd: Mapping[int, Any], captured: tuple[float, float], longest: int
) -> float | None:
    """Return it by its millimetres and the pixels of the sensor in one, both ways alike."""
    tags = ExifTags.Base
    focal = _number(exif_ifd.get(tags.FocalLength))
    across = _number(exif_ifd.get(tags.FocalPlaneXResolution))
    down = _number(exif_ifd.get(tags.FocalPlaneYResolution))
    unit = UNITS.get(exif_ifd.get(tags.FocalPlaneResolutionUnit, 2))
    if not (focal and across and down and unit) or abs(np.log(across / down)) > 0.05:
        return None
    if not SENSOR_WIDTHS[0] <= max(captured) * unit / across <= SENSOR_WIDTHS[1]:
        return None
    zoom = _number(exif_ifd.get(tags.DigitalZoomRatio)) or 1.0
    return focal * zoom * across / unit * longest / max(captured)


def _number(value: Any) -> float | None:
    """Return a positive finite number, of whatever a file has under a tag; else None."""
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if 0 < number < np.inf else None
