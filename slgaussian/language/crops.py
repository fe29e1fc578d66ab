"""Regions of a photograph as square pictures of one size, which is what image encoders look at.

As LangSplat cuts them (and so the paper): what is outside the region is black, the bounding box is
cut out, black margins make it a square with it in the middle, and that is scaled bilinearly.
"""

from __future__ import annotations

import cv2
import numpy as np

from slgaussian.errors import InputError


def check_regions(encoder: str, image: np.ndarray, masks: np.ndarray) -> None:
    """InputError unless masks are bool [M, H, W], none empty, and the image is uint8 [H, W, 3]."""
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise InputError(
            f"{encoder}: image is {image.dtype} {image.shape}, expected uint8 [H, W, 3]"
        )
    if masks.dtype != bool or masks.shape[1:] != image.shape[:2]:
        raise InputError(
            f"{encoder}: masks are {masks.dtype} {masks.shape}, expected bool "
            f"[M, {image.shape[0]}, {image.shape[1]}]"
        )
    empty = ~masks.any((1, 2))
    if empty.any():
        raise InputError(f"{encoder}: mask {int(empty.argmax())} is empty, expected a region")


def region_crop(image: np.ndarray, mask: np.ndarray, side: int, context: bool) -> np.ndarray:
    """The picture of one region.

    Parameters
    ----------
    image : uint8 [H, W, 3]
    mask : bool [H, W]
        Not empty.
    side : int
        Of the picture, pixels.
    context : bool
        Whether the rest of the bounding box stays as it is in place of black.

    Returns
    -------
    uint8 [side, side, 3]
        Where the margin is an odd number of pixels, its smaller half is above or on the left.
    """
    x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
    window = np.s_[y : y + h, x : x + w]
    longest = max(w, h)
    square = np.zeros((longest, longest, 3), np.uint8)
    top, left = (longest - h) // 2, (longest - w) // 2
    patch = image[window] if context else image[window] * mask[window][..., None]
    square[top : top + h, left : left + w] = patch
    return cv2.resize(square, (side, side), interpolation=cv2.INTER_LINEAR)
