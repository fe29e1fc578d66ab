"""Square crops of regions, the input of image encoders.

As in LangSplat and the paper: pixels outside the region are black, the bounding box is cut out,
padded with black to a centred square, and resized bilinearly.
"""

from __future__ import annotations

import cv2
import numpy as np

from slgaussian.errors import InputError


def check_regions(encoder: str, image: np.ndarray, masks: np.ndarray) -> None:
    """Check masks (bool [M, H, W], none empty) and image (uint8 [H, W, 3]), or raise InputError."""
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
    """Crop one region.

    Args:
        image: uint8 [H, W, 3]
        mask: bool [H, W]. Not empty.
        side: Side of the crop, pixels.
        context: If true, the rest of the bounding box is kept instead of being black.

    Returns:
        uint8 [side, side, 3]: Of an odd number of padding pixels, the smaller half is above or on
            the left.
    """
    x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
    window = np.s_[y : y + h, x : x + w]
    longest = max(w, h)
    square = np.zeros((longest, longest, 3), np.uint8)
    top, left = (longest - h) // 2, (longest - w) // 2
    patch = image[window] if context else image[window] * mask[window][..., None]
    square[top : top + h, left : left + w] = patch
    return cv2.resize(square, (side, side), interpolation=cv2.INTER_LINEAR)
