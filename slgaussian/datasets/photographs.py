"""Pixels of photographs of any kind as the RGB uint8 that views hold."""

from __future__ import annotations

import numpy as np
from PIL import Image


def rgb(image: Image.Image) -> np.ndarray:
    """Pixels of an opened image as uint8 [H, W, 3], transparent ones over black.

    Grey is repeated, 16 bits are scaled. ValueError for floating-point pixels.
    """
    if image.mode.startswith("I"):  # 16 bits of grey
        grey = np.clip(np.asarray(image, np.float64) / 257, 0, 255)
        return np.repeat(np.round(grey).astype(np.uint8)[..., None], 3, axis=-1)
    if image.mode == "F":
        raise ValueError("floating-point pixels")
    if "A" in image.getbands() or "transparency" in image.info:
        pixels = np.asarray(image.convert("RGBA"), np.float64)
        return np.round(pixels[..., :3] * pixels[..., 3:] / 255).astype(np.uint8)
    return np.ascontiguousarray(np.asarray(image.convert("RGB")))
