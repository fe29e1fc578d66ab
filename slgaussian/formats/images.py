"""Reading of untrusted image files, with limits on size and format, for all readers.

Size and format are checked before anything is decoded. Some formats of Pillow start other programs
(EPS starts Ghostscript), so only formats of photographs, masks and depth maps are accepted,
whatever the suffix of the file.
"""

from __future__ import annotations

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
def opened(
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
    source: str | Path | BinaryIO, threshold: int = 128, kinds: Sequence[str] = PILLOW_FORMATS
) -> np.ndarray:
    """Read a mask image, bool [H, W]: the pixels whose :func:`mask_levels` reach ``threshold``.

    Raises:
        InputError: If it cannot be read, or no pixel reaches the threshold although some are not
            black.
    """
    levels = mask_levels(source, kinds)
    mask = levels >= threshold
    if levels.any() and not mask.any():
        raise InputError(
            f"{source}: its brightest pixel is {levels.max()}, expected 255 where the mask is"
        )
    return mask


def mask_levels(source: str | Path | BinaryIO, kinds: Sequence[str] = PILLOW_FORMATS) -> np.ndarray:
    """Read the levels of a mask, uint8 [H, W]: 255 inside, 0 outside.

    They are grey levels, 16 bits scaled to 255. An alpha channel that is not 255 everywhere is used
    instead, unless the colours are black and white; those are composited over black.

    Raises:
        InputError: If it cannot be read.
    """
    try:
        with opened(source, kinds) as image:
            if image.mode == "F":
                raise ValueError("floating-point pixels")
            if image.mode.startswith("I"):  # 16 bits of grey
                return np.clip(np.asarray(image) / 257, 0, 255).astype(np.uint8)
            if "A" not in image.getbands() and "transparency" not in image.info:
                return np.asarray(image.convert("L"))
            layers = image.convert("RGBA")
            grey, alpha = np.asarray(layers.convert("L")), np.asarray(layers.getchannel("A"))
    except (OSError, ValueError) as bad:
        raise unreadable(str(source), bad) from None
    if (alpha == 255).all():
        return grey
    levels = np.unique(grey[alpha > 0])
    return np.where(alpha > 0, np.minimum(grey, alpha), 0) if levels.tolist() == [0, 255] else alpha


def read_npy(file: Path) -> np.ndarray:
    """Read a ``.npy`` file of at most :data:`MAX_PIXELS` numbers, without unpickling.

    Raises:
        OSError, ValueError: See :func:`opened`.
    """
    with _damage_as_value_error():
        # Memory mapping detects a header that claims more data than the file has before allocation.
        array = np.lib.format.open_memmap(file, mode="r")
    if array.size > MAX_PIXELS:
        raise TooLargeError(
            f"it has {array.size:,} numbers, of which at most {MAX_PIXELS:,} are read; shrink it"
        )
    return np.array(array)


def unreadable(path: str | Path, bad: Exception) -> InputError:
    """Return the error for a file whose content cannot be read, with the reason."""
    if isinstance(bad, TooLargeError):
        return InputError(f"{path}: cannot be read: {bad}")
    reason = _reason(bad).replace(str(path), "the file").strip(" .")
    return InputError(
        f"{path}: cannot be read ({reason}); it is damaged or of another kind, save it again, a "
        "photograph as JPEG (HEIC needs `pip install pillow-heif`)"
    )


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
