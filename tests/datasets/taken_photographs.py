"""Photographs as telephones and cameras write them: EXIF and orientations."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import skimage.data
from PIL import ExifTags, Image

UNTURN = {
    3: Image.Transpose.ROTATE_180,
    6: Image.Transpose.ROTATE_90,
    8: Image.Transpose.ROTATE_270,
}
"""What makes stored pixels of upright ones, by the orientation that undoes it."""


def taken(
    file: Path,
    pixels: np.ndarray,
    orientation: int | None = None,
    base: Mapping[int, Any] | None = None,
    own: Mapping[int, Any] | None = None,
) -> Path:
    """Write upright ``pixels``, stored turned and with tags: ``base`` ones, and EXIF's ``own``."""
    image = Image.fromarray(pixels)
    if orientation in UNTURN:
        image = image.transpose(UNTURN[orientation])
    exif = Image.Exif()
    exif.update(base or {})
    if orientation is not None:
        exif[ExifTags.Base.Orientation] = orientation
    exif.get_ifd(ExifTags.IFD.Exif).update(own or {})
    image.save(file, exif=exif, **({"quality": 95} if file.suffix == ".jpg" else {}))
    return file


def stereo_pair() -> tuple[np.ndarray, np.ndarray]:
    """The two photographs of the motorcycle, uint8 [500, 741, 3]."""
    left, right, _ = skimage.data.stereo_motorcycle()
    return left, right
