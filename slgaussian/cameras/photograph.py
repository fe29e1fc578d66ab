"""What a photograph brings along when nothing is known of its camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slgaussian.io import short_repr

LONGEST = 1200
"""Pixels of the longer side to which readers shrink what features are found in."""


@dataclass(frozen=True, eq=False)
class Photograph:
    """One photograph, upright, and what its file says of the lens.

    Attributes
    ----------
    name : str
        Unique among those that are looked at together.
    image : uint8 [h, w, 3]
        RGB; may be smaller than the photograph, its shape kept.
    width, height : int
        Size of the whole photograph, upright, pixels.
    lens : str
        What tells lenses apart: maker, model, lens and focal length by EXIF; "" if nothing is said.
        Photographs of one size and one lens share a focal length.
    focal : float or None
        Focal length by EXIF, pixels of the whole photograph.
    up : float64 [3] or None
        Unit vector against gravity in the camera's axes (OpenCV's), where a phone measured it.
    """

    name: str
    image: np.ndarray
    width: int
    height: int
    lens: str = ""
    focal: float | None = None
    up: np.ndarray | None = None

    __repr__ = short_repr
