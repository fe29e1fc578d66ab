"""Photographs as telephones and cameras write them: EXIF, orientations, an iPhone's maker note."""

from __future__ import annotations

import struct
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


def apple_note(x: float, y: float, z: float) -> bytes:
    """A maker note of an iPhone with an acceleration vector and a number before it."""
    numbers = b"".join(struct.pack(">ii", round(value * 10000), 10000) for value in (x, y, z))
    head = b"Apple iOS\0\0\1MM" + struct.pack(">H", 2)
    entries = struct.pack(">HHII", 1, 9, 1, 4) + struct.pack(">HHII", 8, 10, 3, len(head) + 28)
    return head + entries + bytes(4) + numbers


def stereo_pair() -> tuple[np.ndarray, np.ndarray]:
    """The two photographs of the motorcycle, uint8 [500, 741, 3]."""
    left, right, _ = skimage.data.stereo_motorcycle()
    return left, right
