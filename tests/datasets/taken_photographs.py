"""Photographs as phones and cameras store them: orientation and EXIF tags."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import skimage.data
from PIL import ExifTags, Image

TO_STORED = {
    3: Image.Transpose.ROTATE_180,
    6: Image.Transpose.ROTATE_90,
    8: Image.Transpose.ROTATE_270,
}
"""By EXIF orientation: the transposition from upright to stored pixels."""


def write_photograph(
    file: Path,
    pixels: np.ndarray,
    orientation: int | None = None,
    base: Mapping[int, Any] | None = None,
    exif: Mapping[int, Any] | None = None,
) -> Path:
    """Write upright ``pixels`` as stored with an orientation, with tags of the two directories."""
    image = Image.fromarray(pixels)
    if orientation in TO_STORED:
        image = image.transpose(TO_STORED[orientation])
    tags = Image.Exif()
    tags.update(base or {})
    if orientation is not None:
        tags[ExifTags.Base.Orientation] = orientation
    tags.get_ifd(ExifTags.IFD.Exif).update(exif or {})
    image.save(file, exif=tags, **({"quality": 95} if file.suffix == ".jpg" else {}))
    return file


def stereo_pair() -> tuple[np.ndarray, np.ndarray]:
    """The two photographs of the motorcycle, uint8 [500, 741, 3]."""
    left, right, _ = skimage.data.stereo_motorcycle()
    return left, right
