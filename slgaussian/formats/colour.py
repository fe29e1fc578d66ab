"""Conversion of photographs to sRGB, by the profile of their colours.

An embedded ICC profile is followed before anything else; without one, in PNG the chunks ``cHRM``
and ``gAMA`` unless ``sRGB`` overrides them, and in EXIF the mark of Adobe RGB (DCF 2.0, section
3.4). Without any of them colours are sRGB.
"""

from __future__ import annotations

import io
import warnings
from functools import lru_cache

import numpy as np
from PIL import ExifTags, Image, ImageCms

SRGB = (0.3127, 0.3290, 0.64, 0.33, 0.30, 0.60, 0.15, 0.06)
"""Chromaticities x, y of white, red, green and blue, in the order of PNG's ``cHRM``."""

ADOBE_RGB = (0.3127, 0.3290, 0.64, 0.33, 0.21, 0.71, 0.15, 0.06), 256 / 563
"""Chromaticities, and the exponent from light to levels."""

BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
STRIP_ROWS = 256  # rows that are converted together, which bounds the memory
MODES = {"RGB ": "RGB", "GRAY": "L", "CMYK": "CMYK"}  # Pillow's mode by the space of a profile


def decode_srgb(level: np.ndarray) -> np.ndarray:
    """Return the linear light of sRGB values in [0, 1] (IEC 61966-2-1)."""
    return np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)


def encode_srgb(light: np.ndarray) -> np.ndarray:
    """Return the sRGB values of linear light in [0, 1]."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def read_colours(image: Image.Image, name: str) -> np.ndarray:
    """Return the colours of an opened image in sRGB, uint8 [H, W, 3], without regard to alpha.

    Grey is repeated, 16 bits are scaled. A damaged profile, or one of other channels, is left out
    with a warning that begins with ``name``. Raises ValueError for floating-point pixels.
    """
    if image.mode == "F":
        raise ValueError("floating-point pixels")
    base = image
    if image.mode.startswith("I"):  # 16 bits of grey
        grey = np.round(np.clip(np.asarray(image) / 257, 0, 255)).astype(np.uint8)
        base = Image.fromarray(grey)
    elif image.mode not in ("RGB", "L", "CMYK"):
        base = image.convert("L" if image.mode in ("1", "LA") else "RGB")
    if profile := image.info.get("icc_profile"):
        try:
            mode, transform = _transform(profile)
            if base.mode != mode and (base.mode, mode) != ("L", "RGB"):
                raise ValueError(f"it is of {mode} and the pixels are {base.mode}")
            if transform is not None:
                return np.array(transform.apply(base.convert(mode)))
        except (ImageCms.PyCMSError, OSError, ValueError, KeyError) as bad:
            warnings.warn(
                f"{name}: its colour profile cannot be used ({bad}), so its colours are read as "
                "sRGB; save it with a valid profile if they are not",
                stacklevel=3,
            )
    pixels = np.array(base if base.mode == "RGB" else base.convert("RGB"))
    primaries, gamma = _stated_space(image)
    if primaries or gamma:
        level = np.arange(256) / 255
        light = (level ** (1 / gamma) if gamma else decode_srgb(level)).astype(np.float32)
        matrix = np.linalg.solve(_to_xyz(SRGB), _to_xyz(primaries or SRGB))
        for first in range(0, len(pixels), STRIP_ROWS):
            strip = pixels[first : first + STRIP_ROWS]
            strip[:] = np.round(255 * encode_srgb((light[strip] @ matrix.T).clip(0, 1)))
    return pixels


def is_srgb(image: Image.Image) -> bool:
    """Tell whether the file of an opened image states no other colours than sRGB."""
    try:
        profile = image.info.get("icc_profile")
        return not any(_stated_space(image)) and not (profile and _transform(profile)[1])
    except (ImageCms.PyCMSError, OSError, ValueError, KeyError):
        return False


@lru_cache(maxsize=16)
def _transform(profile: bytes) -> tuple[str, ImageCms.ImageCmsTransform | None]:
    """Return the mode of a profile, and its transform to sRGB; None if it changes no level by 2.

    Profiles called sRGB differ in the rounding of their curves.
    """
    stored, srgb = ImageCms.getOpenProfile(io.BytesIO(profile)), ImageCms.createProfile("sRGB")
    mode = MODES[stored.profile.xcolor_space]
    intent = ImageCms.Intent.RELATIVE_COLORIMETRIC
    transform = ImageCms.buildTransform(stored, srgb, mode, "RGB", intent)
    if mode == "CMYK":
        return mode, transform
    ramp = np.arange(256, dtype=np.uint8)
    colours = np.stack(np.meshgrid(*[ramp[::15]] * 3), -1).reshape(18, -1, 3)
    test = Image.fromarray(colours if mode == "RGB" else ramp[None])
    change = np.asarray(transform.apply(test), int) - np.asarray(test.convert("RGB"))
    return mode, None if np.abs(change).max() <= 1 else transform


def _stated_space(image: Image.Image) -> tuple[tuple[float, ...] | None, float | None]:
    """Return primaries and exponent that a header states without a profile; None for sRGB's."""
    info = image.info
    primaries, gamma = info.get("chromaticity"), info.get("gamma")
    if info.get("icc_profile"):
        return None, None
    if "srgb" in info or not (primaries or gamma):
        return ADOBE_RGB if _is_adobe_rgb(image) else (None, None)
    if primaries and np.allclose(primaries, SRGB, atol=0.002):
        primaries = None
    # 1 / 2.2 is what PNG has for the curve of sRGB.
    return primaries, None if not gamma or abs(gamma * 2.2 - 1) < 0.01 else gamma


def _is_adobe_rgb(image: Image.Image) -> bool:
    try:
        exif = image.getexif()
        space = exif.get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.ColorSpace)
        index = str(exif.get_ifd(ExifTags.IFD.Interop).get(ExifTags.Interop.InteropIndex, ""))
    except Exception:  # a damaged header raises almost anything, and the pixels may be good
        return False
    return space == 2 or (space != 1 and index.startswith("R03"))


def _to_xyz(chromaticities: tuple[float, ...]) -> np.ndarray:
    """Return the matrix [3, 3] from linear RGB to XYZ, adapted to the white of sRGB (Bradford)."""
    x, y = np.array(chromaticities, np.float64).reshape(4, 2).T
    white, *_ = columns = np.stack([x / y, np.ones(4), (1 - x - y) / y], 1)
    to_xyz = columns[1:].T * np.linalg.solve(columns[1:].T, white)
    target = np.array([SRGB[0] / SRGB[1], 1, (1 - SRGB[0] - SRGB[1]) / SRGB[1]])
    cones = np.diag((BRADFORD @ target) / (BRADFORD @ white))
    return np.linalg.solve(BRADFORD, cones @ BRADFORD @ to_xyz)
