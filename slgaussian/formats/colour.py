"""Conversion of photographs to sRGB, by the profile of their colours.

An embedded ICC profile is followed before anything else; without one, in PNG the chunks ``cHRM``
and ``gAMA`` unless ``sRGB`` overrides them, in HEIC the primaries of its header, and in EXIF the
mark of Adobe RGB (DCF 2.0, section 3.4). Without any of them colours are sRGB.
"""

from __future__ import annotations

import io
import warnings
from functools import lru_cache

import numpy as np
from PIL import ExifTags, Image, ImageCms

SRGB = (0.3127, 0.3290, 0.64, 0.33, 0.30, 0.60, 0.15, 0.06)
"""Chromaticities x, y of white, red, green and blue, in the order of PNG's ``cHRM``."""

ADOBE_RGB = (0.3127, 0.3290, 0.64, 0.33, 0.21, 0.71, 0.15, 0.06)
HEADER_PRIMARIES = {
    9: (0.3127, 0.3290, 0.708, 0.292, 0.170, 0.797, 0.131, 0.046),
    12: (0.3127, 0.3290, 0.680, 0.320, 0.265, 0.690, 0.150, 0.060),
}
"""Chromaticities of BT.2020 and Display P3 by their number in ITU-T H.273."""

ADOBE_GAMMA = 256 / 563
BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
STRIP_ROWS = 256  # rows that are converted together, which bounds the memory
MODES = {"RGB ": "RGB", "GRAY": "L", "CMYK": "CMYK"}  # Pillow's mode by the space of a profile


def read_colours(image: Image.Image, name: str) -> np.ndarray:
    """Return the colours of an opened image in sRGB, uint8 [H, W, 3], without regard to alpha.

    Grey is repeated, 16 bits are scaled. A damaged profile, or one of other channels, is left out
    with a warning that begins with ``name``. Raises ValueError for floating-point pixels.
    """
    if image.mode == "F":
        raise ValueError("floating-point pixels")
    info, base = image.info, image
    if image.mode.startswith("I"):  # 16 bits of grey
        grey = np.round(np.clip(np.asarray(image) / 257, 0, 255)).astype(np.uint8)
        base = Image.fromarray(grey)
    elif image.mode not in ("RGB", "L", "CMYK"):
        base = image.convert("L" if image.mode in ("1", "LA") else "RGB")
    if profile := info.get("icc_profile"):
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
    primaries, gamma = (None, None) if profile else _stated_space(image)
    if primaries or gamma:
        light, matrix = _decode(gamma), np.linalg.solve(_to_xyz(SRGB), _to_xyz(primaries or SRGB))
        for first in range(0, len(pixels), STRIP_ROWS):
            strip = pixels[first : first + STRIP_ROWS]
            strip[:] = _encode(light[strip] @ matrix.T)
    return pixels


def is_srgb(image: Image.Image) -> bool:
    """Tell whether the file of an opened image states no other colours than sRGB."""
    profile = image.info.get("icc_profile")
    try:
        return _transform(profile)[1] is None if profile else _stated_space(image) == (None, None)
    except (ImageCms.PyCMSError, OSError, ValueError, KeyError):
        return False


@lru_cache(maxsize=16)
def _transform(profile: bytes) -> tuple[str, ImageCms.ImageCmsTransform | None]:
    """Return the mode of a profile, and the transform to sRGB; None if it changes no level by 2.

    Profiles called sRGB differ in the rounding of their curves.
    """
    stored = ImageCms.getOpenProfile(io.BytesIO(profile))
    mode = MODES[stored.profile.xcolor_space]
    transform = ImageCms.buildTransform(
        stored,
        ImageCms.createProfile("sRGB"),
        mode,
        "RGB",
        ImageCms.Intent.RELATIVE_COLORIMETRIC,
    )
    if mode == "CMYK":
        return mode, transform
    ramp = np.arange(256, dtype=np.uint8)
    colours = np.stack(np.meshgrid(*[ramp[::15]] * 3), -1).reshape(18, -1, 3)
    test = Image.fromarray(colours if mode == "RGB" else ramp[None])
    change = np.asarray(transform.apply(test), int) - np.asarray(test.convert("RGB"))
    return mode, None if np.abs(change).max() <= 1 else transform


def _stated_space(image: Image.Image) -> tuple[tuple[float, ...] | None, float | None]:
    """Return primaries and exponent that a header states; None for those of sRGB."""
    info = image.info
    if number := (info.get("nclx_profile") or {}).get("color_primaries"):
        return HEADER_PRIMARIES.get(number), None
    primaries, gamma = info.get("chromaticity"), info.get("gamma")
    if "srgb" in info or not (primaries or gamma):
        return (ADOBE_RGB, ADOBE_GAMMA) if _is_adobe_rgb(image) else (None, None)
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


def _decode(gamma: float | None) -> np.ndarray:
    """Return the light of each level, float32 [256], by a power or by the curve of sRGB."""
    level = np.arange(256) / 255
    curve = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
    return (level ** (1 / gamma) if gamma else curve).astype(np.float32)


def _encode(light: np.ndarray) -> np.ndarray:
    """Encode linear sRGB as levels, uint8."""
    light = light.clip(0, 1)
    level = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.round(255 * level).astype(np.uint8)
