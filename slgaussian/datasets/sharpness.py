"""Quality of a photograph: a small grey look at it, its blur and its exposure."""

from __future__ import annotations

import io

import cv2
import numpy as np

from slgaussian.errors import InputError
from slgaussian.formats.images import opened

SIDE = 180
"""Shorter side of a small look, pixels. A JPEG of 640 x 360 is decoded at half its size for it,
which takes a third of the time."""

REBLUR = 7
"""Pixels that a look is blurred again over, which an image that is blurred already hardly minds."""

CLIPPED = 4
"""Grey levels from black or white that count as clipped."""


def glance(data: bytes) -> tuple[np.ndarray, tuple[int, int]]:
    """Decode a photograph in grey, uint8 [h, w], its shorter side :data:`SIDE` pixels or fewer.

    Returns
    -------
    uint8 [h, w], (width, height)
        The look and the full size of the photograph.

    Raises
    ------
    InputError
        If it cannot be decoded.
    """
    try:
        with opened(io.BytesIO(data)) as image:
            size = image.size
            scale = min(1.0, SIDE / min(size))
            small = max(1, round(size[0] * scale)), max(1, round(size[1] * scale))
            image.draft("L", small)
            grey = np.asarray(image.convert("L"))
    except ValueError as error:
        raise InputError(f"its JPEG cannot be decoded ({error})") from None
    return cv2.resize(grey, small, interpolation=cv2.INTER_AREA), size


def small(image: np.ndarray) -> np.ndarray:
    """Make a photograph uint8 [H, W, 3] grey and as small as :func:`glance` makes it."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    scale = min(1.0, SIDE / min(grey.shape))
    size = max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale))
    return cv2.resize(grey, size, interpolation=cv2.INTER_AREA)


def blur(grey: np.ndarray) -> float:
    """Measure the blur of an image uint8 [h, w] from 0, sharp, to 1; without any edge 1.

    The fraction of its edges that survive another blur, in the worse of the two directions (Crete
    et al., "The blur effect", 2007). Unlike the variance of the Laplacian it hardly depends on how
    much there is to see: a sharp photograph of a blank door counts as sharp.
    """
    if min(grey.shape) < REBLUR:
        return 1.0
    from skimage.measure import blur_effect  # only where views are chosen: it takes long to import

    return float(blur_effect(grey, h_size=REBLUR))


def exposure(grey: np.ndarray) -> tuple[float, float]:
    """Return the mean of an image uint8 [h, w], 0 to 1, and the fraction of clipped pixels."""
    clipped = (grey <= CLIPPED) | (grey >= 255 - CLIPPED)
    return float(grey.mean() / 255), float(clipped.mean())
