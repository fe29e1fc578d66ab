"""Image files that anybody made: how large they may be, and the one way in for every reader.

Size and kind are looked at before anything is decoded. Some kinds that Pillow knows start other
programs (EPS starts Ghostscript), so only those of photographs, masks and depth maps are taken,
whatever a file is called.
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

MOST_PIXELS = 2**30 // 12
"""Pixels of the largest image, mask, depth map or camera: 89 million, a quarter of a GiB as RGB,
from where on Pillow warns of files that are made to fill the memory."""

KINDS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "PPM")
"""Pillow's names of the kinds of file that are opened; HEIC too where a package reads it."""


class TooLargeError(ValueError):
    """An image of more than :data:`MOST_PIXELS`."""


def check_size(width: float, height: float) -> None:
    """Raise :class:`TooLargeError` if an image of that size is not read."""
    if width * height > MOST_PIXELS:
        raise TooLargeError(
            f"it has {width:.0f}x{height:.0f} pixels, of which at most {MOST_PIXELS:,} are read; "
            "shrink it"
        )


@contextmanager
def opened(source: str | Path | BinaryIO, kinds: Sequence[str] = KINDS) -> Iterator[Image.Image]:
    """An image, known by its header only; its pixels are to be taken inside the ``with``.

    Raises
    ------
    OSError
        If the file is not there or cannot be read.
    ValueError
        If it is none of these kinds, is damaged, has no pixel or more than :data:`MOST_PIXELS`,
        there or where its pixels are taken. :func:`unreadable` makes a sentence of both.
    """
    if isinstance(source, str | Path) and _phone_kind(source) == "HEIC" and _reads_heic():
        kinds = (*kinds, "HEIF")
    try:
        with Image.open(source, formats=tuple(kinds)) as image:
            check_size(*image.size)
            if not min(image.size):
                raise ValueError("it has no pixel")
            yield image
    except (InputError, TooLargeError):
        raise
    except Image.DecompressionBombError:
        raise TooLargeError(
            f"it has more than the {MOST_PIXELS:,} pixels that are read; shrink it"
        ) from None
    except Exception as bad:  # a damaged file raises almost anything
        if isinstance(bad, OSError) and bad.errno is not None:
            raise
        raise ValueError(_reason(bad)) from None


def read_mask(
    source: str | Path | BinaryIO, threshold: int = 128, kinds: Sequence[str] = KINDS
) -> np.ndarray:
    """Read a mask of any kind of image, bool [H, W]: its :func:`mask_levels` from ``threshold`` on.

    Raises
    ------
    InputError
        If it cannot be read, or no pixel is set though some are not black.
    """
    levels = mask_levels(source, kinds)
    mask = levels >= threshold
    if levels.any() and not mask.any():
        raise InputError(
            f"{source}: its brightest pixel is {levels.max()}, expected 255 where the mask is"
        )
    return mask


def mask_levels(source: str | Path | BinaryIO, kinds: Sequence[str] = KINDS) -> np.ndarray:
    """Read the levels of a mask, uint8 [H, W]: 255 where it is, 0 where not.

    They are grey levels, of 16 bits scaled to 255. Alpha that is not 255 everywhere is the mask
    instead, unless what it shows is black and white itself, which is laid over black.

    Raises
    ------
    InputError
        If it cannot be read.
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
    """The array of a ``.npy`` file of at most :data:`MOST_PIXELS` numbers; never a pickle.

    Raises
    ------
    OSError, ValueError
        As :func:`opened`.
    """
    try:
        # Mapped, so that a size that the file does not have is found out before it is allocated.
        array = np.lib.format.open_memmap(file, mode="r")
    except Exception as bad:  # a damaged header raises almost anything
        if isinstance(bad, OSError) and bad.errno is not None:
            raise
        raise ValueError(_reason(bad)) from None
    if array.size > MOST_PIXELS:
        raise TooLargeError(
            f"it has {array.size:,} numbers, of which at most {MOST_PIXELS:,} are read; shrink it"
        )
    return np.array(array)


def unreadable(path: str | Path, bad: Exception) -> InputError:
    """The error that says of a file that its content cannot be read, and why."""
    kind = _phone_kind(path)
    if kind == "AVIF" or (kind == "HEIC" and not _reads_heic()):
        jpeg = Path(path).with_suffix(".jpg").name
        package = "`pip install pillow-heif`, or " if kind == "HEIC" else ""
        return InputError(
            f"{path}: is a photograph in {kind}, which is not read; {package}convert it to JPEG, "
            f"as with `magick {Path(path).name} {jpeg}` (ImageMagick) or `sips -s format jpeg "
            f"{Path(path).name} --out {jpeg}` (macOS), and give the new file"
        )
    if isinstance(bad, TooLargeError):
        return InputError(f"{path}: cannot be read: {bad}")
    reason = _reason(bad).replace(str(path), "the file").strip(" .")
    return InputError(
        f"{path}: cannot be read ({reason}); it is damaged or of another kind, save it again"
    )


def _phone_kind(path: str | Path) -> str | None:
    """HEIC or AVIF, as telephones write, by the first bytes (ISO/IEC 23008-12, `ftyp` box)."""
    try:
        with Path(path).open("rb") as file:
            start = file.read(12)
    except (OSError, ValueError):
        return None
    if start[4:8] != b"ftyp":
        return None
    brands = {b"avif": "AVIF", b"avis": "AVIF"} | dict.fromkeys(
        (b"heic", b"heix", b"hevc", b"hevx", b"heim", b"heis", b"mif1", b"msf1"), "HEIC"
    )
    return brands.get(start[8:12])


@cache
def _reads_heic() -> bool:
    """Tell whether the package of the extra `heic` is here; Pillow then knows the kind too."""
    try:
        from pillow_heif import register_heif_opener
    except ImportError:
        return False
    register_heif_opener()
    return True


def _reason(bad: Exception) -> str:
    """The first line of what an error says, without the address of a stream in memory."""
    if isinstance(bad, Image.UnidentifiedImageError):
        return "no image of a kind that is read"
    if isinstance(bad, OSError) and bad.strerror:
        return bad.strerror
    lines = str(bad).strip().splitlines()
    return lines[0][:200] if lines else type(bad).__name__
