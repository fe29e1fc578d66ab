"""Plausibility check of intrinsics, which detects files with numbers in another unit."""

from __future__ import annotations

import math

from slgaussian.errors import InputError
from slgaussian.scene import Camera

NARROWEST, WIDEST = 3.0, 175.0
"""Range of plausible fields of view, degrees."""


def checked_camera(camera: Camera, fractions: bool = False) -> Camera:
    """Return a camera unchanged if its intrinsics are plausible; every reader calls this.

    The field of view across each side is at most :data:`WIDEST` degrees, and across the longer
    side, with either focal length, at least :data:`NARROWEST`. The principal point is at most a
    photograph's size away from the photograph, and not in its first pixel, where fractions lie.

    Args:
        fractions: Whether the file has fractions of width and height, as in RealEstate10K, not
            pixels.

    Raises:
        InputError: If they are not; the message gives the number as in the file.
    """
    width, height = camera.width, camera.height
    unit = "fractions of width and height" if fractions else "pixels"
    for axis, focal, side in (("x", camera.K[0, 0], width), ("y", camera.K[1, 1], height)):
        sides = (side, max(width, height))
        view, longest_view = (math.degrees(2 * math.atan2(s / 2, focal)) for s in sides)
        if view > WIDEST or longest_view < NARROWEST:
            raise InputError(
                f"focal length {axis} is {focal / side if fractions else focal:.6g}, for "
                f"{width}x{height} pixels a field of view of {view:.3g} degrees, expected "
                f"{NARROWEST:g} to {WIDEST:g}; give it in {unit}"
            )
    x, y = camera.K[:2, 2]
    is_near = -width <= x <= 2 * width and -height <= y <= 2 * height
    is_fraction = not fractions and 0 <= x < 1 and 0 <= y < 1 and min(width, height) > 2
    if not is_near or is_fraction:
        x, y = (x / width, y / height) if fractions else (x, y)
        raise InputError(
            f"principal point is ({x:.6g}, {y:.6g}), far from the middle of {width}x{height} "
            f"pixels; give it in {unit}"
        )
    return camera
