"""Where labels drawn on a photograph land when it is brought to another size."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from slgaussian.errors import InputError
from slgaussian.formats.images import MOST_PIXELS


@dataclass(frozen=True)
class Placement:
    """How :meth:`slgaussian.scene.View.resized` brings an image to a size: scaled, centre-cropped.

    Attributes
    ----------
    width, height : int
        The size it is brought to.
    wide, high : int
        The size it is scaled to, which covers that one.
    left, top : int
        Where the crop begins, in pixels of the scaled image.
    """

    width: int
    height: int
    wide: int
    high: int
    left: int
    top: int

    @classmethod
    def of(cls, full_w: int, full_h: int, width: int, height: int) -> Placement:
        """The placement of an image of ``full_w`` x ``full_h`` pixels.

        InputError if the shapes differ by so much that it would be scaled to too many pixels.
        """
        scale = max(height / full_h, width / full_w)
        wide, high = max(width, round(full_w * scale)), max(height, round(full_h * scale))
        if wide * high > MOST_PIXELS:
            raise InputError(
                f"labels of {full_w}x{full_h} pixels are of another shape than the view of "
                f"{width}x{height}; draw them on its photograph"
            )
        return cls(width, height, wide, high, (wide - width) // 2, (high - height) // 2)

    def fit(self, mask: np.ndarray) -> np.ndarray:
        """A mask uint8 of the whole image as uint8 [height, width]; nearest pixels."""
        scaled = cv2.resize(mask, (self.wide, self.high), interpolation=cv2.INTER_NEAREST)
        return scaled[self.top : self.top + self.height, self.left : self.left + self.width]
