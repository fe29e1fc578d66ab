"""Reading of untrusted image files, with limits on size and format, for all readers.

Size and format are checked before anything is decoded. Some formats of Pillow start other programs
(EPS starts Ghostscript), so only formats of photographs, masks and depth maps are accepted,
whatever the suffix of the file.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import BinaryIO

import numpy as np
from PIL import Image

from slgaussian.errors import InputError

MAX_PIXELS = 2**30 // 12
"""Largest number of pixels of an image, mask, depth map or camera: 89 million, a quarter of a GiB
as RGB, above which Pillow warns of decompression bombs."""

PILLOW_FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "PPM")
"""Pillow's names of the accepted formats; HEIC too if pillow-heif is installed."""

PHOTOGRAPH_ADVICE = (
    "it is damaged or of another kind, save it again, a photograph as JPEG (HEIC needs `pip "
    "install pillow-heif`)"
)
MASK_ADVICE = "save the mask as a grey PNG, 0 outside and 255 inside"


class TooLargeError(ValueError):
    """An image has more than :data:`MAX_PIXELS` pixels."""


def check_size(width: float, height: float) -> None:
    """Raise :class:`TooLargeError` for an image of more than :data:`MAX_PIXELS` pixels."""
    if width * height > MAX_PIXELS:
        raise TooLargeError(
            f"it has {width:.0f}x{height:.0f} pixels, of which at most {MAX_PIXELS:,} are read; "
            "shrink it"
        )


@contextmanager
def open_image(
    source: str | Path | BinaryIO, kinds: Sequence[str] = PILLOW_FORMATS
) -> Iterator[Image.Image]:
    """Open an image and read its header only; load the pixels inside the ``with`` block.

    Raises:
        OSError, ValueError: If the file cannot be read; or if it has another format, is damaged,
            empty or above :data:`MAX_PIXELS`, also while the pixels are loaded.
            :func:`unreadable` converts both errors to a message.
    """
    if Path(str(source)).suffix.lower() in (".heic", ".heif") and _reads_heic():
        kinds = (*kinds, "HEIF")
    with _damage_as_value_error(), Image.open(source, formats=tuple(kinds)) as image:
        check_size(*image.size)
        if not min(image.size):
            raise ValueError("it has no pixel")
        yield image


@contextmanager
def _damage_as_value_error() -> Iterator[None]:
    try:
        yield
    except (InputError, TooLargeError):
        raise
    except Image.DecompressionBombError:
        raise TooLargeError(
            f"it has more than the {MAX_PIXELS:,} pixels that are read; shrink it"
        ) from None
    except Exception as bad:  # a damaged file raises almost anything
        if isinstance(bad, OSError) and bad.errno is not None:
            raise
        raise ValueError(_reason(bad)) from None


def read_mask(
    source: str | Path | BinaryIO,
    threshold: int = 128,
    kinds: Sequence[str] = PILLOW_FORMATS,
    warn: bool = True,
) -> np.ndarray:
    """Read a mask image, bool [H, W]: the pixels whose :func:`mask_levels` reach ``threshold``.

    Raises:
        InputError: If it cannot be read, or no pixel reaches the threshold although some are not
            black.
    """
    levels = mask_levels(source, kinds, warn)
    mask = levels >= threshold
    if levels.any() and not mask.any():
        raise InputError(
            f"{source}: its brightest pixel is {levels.max()}, expected 255 where the mask is"
        )
    return mask


def mask_levels(
    source: str | Path | BinaryIO, kinds: Sequence[str] = PILLOW_FORMATS, warn: bool = True
) -> np.ndarray:
    """Read the levels of a mask, uint8 [H, W]: 255 inside, 0 outside.

    They are grey levels, in the range that :func:`scale_levels` finds in them. An alpha channel
    that is not opaque everywhere is used instead, unless the colours are black and white; those are
    composited over black. Of two colours, one of them black, the other is inside. With ``warn``,
    an empty mask is said.

    Raises:
        InputError: If it cannot be read, or its range is not clear.
    """
    try:
        with open_image(source, kinds) as image:
            is_halved = ";16" in str(getattr(image, "tile", "")) and not image.mode.startswith("I")
            levels = _grey_or_alpha(image)
            if is_halved and not levels.any():  # Pillow reads the upper 8 bits of such colours
                raise ValueError("colours of 16 bits that are all below 256")
    except (OSError, ValueError) as bad:
        raise unreadable(str(source), bad, MASK_ADVICE) from None
    if warn and not levels.any():
        warnings.warn(f"{source}: the mask is empty, all of its pixels are 0", stacklevel=3)
    return levels


def _grey_or_alpha(image: Image.Image) -> np.ndarray:
    if image.mode == "F" or image.mode.startswith("I"):
        return scale_levels(np.asarray(image))
    if "A" not in image.getbands() and "transparency" not in image.info:
        grey = np.asarray(image.convert("L"))
        colours = [] if image.mode in ("1", "L") else image.convert("RGB").getcolors(2)
        if colours and len(colours) == 2 and (0, 0, 0) in [colour for _, colour in colours]:
            return np.where(grey > 0, 255, 0).astype(np.uint8)
        return scale_levels(grey)
    layers = image.convert("RGBA")
    grey = np.asarray(layers.convert("L"))
    alpha = scale_levels(np.asarray(layers.getchannel("A")))
    if (alpha == 255).all():
        return scale_levels(grey)
    is_mask = np.unique(grey[alpha > 0]).tolist() in ([0, 1], [0, 255])
    return np.where(grey > 0, alpha, 0) if is_mask else alpha


def scale_levels(values: np.ndarray) -> np.ndarray:
    """Scale the values [H, W] of a mask or of alpha to levels uint8 from 0, outside, to 255.

    Their largest value tells the range, whatever the type: that of 1, 8 or 16 bits.

    Raises:
        ValueError: If it tells none, or a value is negative or not a number.
    """
    low, high = float(values.min()), float(values.max())
    if values.dtype == np.uint8 and (high >= 128 or high == 0):
        return values
    if values.dtype.kind == "f":
        spans = [span for span in (1, 255, 65535) if span / 2 < high <= span]
    elif high == 257 and np.isin(values, (0, 257)).all():
        spans = [257]  # 1 of 8 bits, scaled to 16
    else:  # 65280 is 255, shifted by 8 bits
        spans = [int(high)] if high in (1, 255, 65280) else [65535] * (2**15 <= high < 2**16)
    if not (low >= 0 and (spans or high == 0)):
        raise ValueError(
            f"its mask or alpha has values from {low:g} to {high:g}, which are not clear"
        )
    return (values * (255 / (spans or [1])[0])).astype(np.uint8)


def read_npy(file: Path) -> np.ndarray:
    """Read a ``.npy`` file of at most :data:`MAX_PIXELS` numbers, without unpickling.

    Raises:
        OSError, ValueError: See :func:`open_image`.
    """
    with _damage_as_value_error():
        # Memory mapping detects a header that claims more data than the file has before allocation.
        array = np.lib.format.open_memmap(file, mode="r")
    if array.size > MAX_PIXELS:
        raise TooLargeError(
            f"it has {array.size:,} numbers, of which at most {MAX_PIXELS:,} are read; shrink it"
        )
    return np.array(array)


def unreadable(path: str | Path, bad: Exception, advice: str = PHOTOGRAPH_ADVICE) -> InputError:
    """Return the error for a file whose content cannot be read, with the reason and the advice."""
    if isinstance(bad, TooLargeError):
        return InputError(f"{path}: cannot be read: {bad}")
    reason = _reason(bad).replace(str(path), "the file").strip(" .")
    return InputError(f"{path}: cannot be read ({reason}); {advice}")


@cache
def _reads_heic() -> bool:
    """Tell whether pillow-heif (extra `heic`) is installed, and register it with Pillow."""
    try:
        from pillow_heif import register_heif_opener
    except ImportError:
        return False
    register_heif_opener()
    return True


def _reason(bad: Exception) -> str:
    """Return the first line of an error message; Pillow's own contains a memory address."""
    if isinstance(bad, Image.UnidentifiedImageError):
        return "not an image of a supported format"
    if isinstance(bad, OSError) and bad.strerror:
        return bad.strerror
    lines = str(bad).strip().splitlines()
    return lines[0][:200] if lines else type(bad).__name__
