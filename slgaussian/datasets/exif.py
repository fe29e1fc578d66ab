"""Lens and orientation of a photograph from the EXIF header of its file.

Tags and their meaning are those of CIPA DC-008, "Exchangeable image file format for digital still
cameras", and of ExifTool's tables (https://exiftool.org/TagNames/EXIF.html).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from PIL import ExifTags, Image

FILM_DIAGONAL = 43.27  # diagonal of 35 mm film, 36 x 24, in millimetres
MIN_FOCAL, MAX_FOCAL = 0.3, 20.0  # range of plausible focal lengths, in units of the longer side
RESOLUTION_UNITS = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # of the focal plane, millimetres
SIDEWAYS_ORIENTATIONS = (5, 6, 7, 8)  # EXIF orientations that exchange width and height

TRANSPOSED = dict(zip(range(2, 9), map(Image.Transpose, (0, 3, 1, 5, 4, 6, 2)), strict=True))
"""Operation that turns a stored photograph upright, by EXIF orientation."""


def read_orientation(image: Image.Image) -> int:
    """Return the EXIF orientation of an opened image, 1 to 8; 1 if it is missing or invalid.

    Pillow itself rotates a TIFF when it loads the pixels; afterwards the orientation is 1.
    """
    try:
        stated = image.getexif().get(ExifTags.Base.Orientation, 1)
    except Exception:  # a damaged header raises almost anything
        return 1
    return stated if stated in range(1, 9) else 1


def upright(image: Image.Image, orientation: int) -> Image.Image:
    """Turn an image upright; Pillow's ``exif_transpose`` fails on other invalid tags."""
    return image if orientation == 1 else image.transpose(TRANSPOSED[orientation])


def read_lens(image: Image.Image) -> tuple[str, float | None]:
    """Read lens and focal length of an opened image; invalid values are ignored.

    See the fields of :class:`slgaussian.cameras.two_view.Photograph`.
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
    for tag, unit in ((tags.FocalLength, "mm"), (tags.FocalLengthIn35mmFilm, "mm of 35")):
        if number := _number(exif_ifd.get(tag)):
            words.append(f"{number:.4g} {unit}")
    return ", ".join(filter(None, words))


def _focal(exif_ifd: Mapping[int, Any], width: int, height: int) -> float | None:
    """Return the focal length in pixels of a photograph of the given size, upright or not.

    It is that for 35 mm film, of equal field of view and with digital zoom, or else that of the
    lens over the resolution of the sensor.
    """
    tags = ExifTags.Base

    def number(tag: int) -> float | None:
        return _number(exif_ifd.get(tag))

    across, down = number(tags.ExifImageWidth), number(tags.ExifImageHeight)
    captured = (across, down) if across and down else (float(width), float(height))
    longest = max(width, height)
    # Another aspect ratio than captured means a crop, whose position and scale are unknown.
    if abs(np.log(max(captured) / min(captured) / (longest / min(width, height)))) > 0.01:
        return None
    film = number(tags.FocalLengthIn35mmFilm) or 0.0
    focals = [film * float(np.hypot(width, height)) / FILM_DIAGONAL]
    focal = number(tags.FocalLength)
    x, y = number(tags.FocalPlaneXResolution), number(tags.FocalPlaneYResolution)
    unit = RESOLUTION_UNITS.get(exif_ifd.get(tags.FocalPlaneResolutionUnit, 2))
    if focal and x and y and unit and abs(np.log(x / y)) <= 0.05:
        zoom = number(tags.DigitalZoomRatio) or 1.0
        focals.append(focal * zoom * x / unit * longest / max(captured))
    return next((f for f in focals if MIN_FOCAL <= f / longest <= MAX_FOCAL), None)


def _number(value: Any) -> float | None:
    """Return the value of a tag as a positive finite number; None if it is not one."""
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if 0 < number < np.inf else None
