"""Plausibility check of intrinsics, which detects files with numbers in another unit."""

from __future__ import annotations

import math

from slgaussian.errors import InputError
from slgaussian.scene import Camera

NARROWEST, WIDEST = 3.0, 175.0
"""Range of plausible fields of view, degrees."""

LEAST_MILLIMETRES = 3.0
"""Too small focal lengths are probably millimetres from this value on, and fractions below it."""


def checked_camera(camera: Camera, fractions: bool = False) -> Camera:
    """Return a camera unchanged if its intrinsics are plausible; every reader calls this.

    The field of view across each side is at most :data:`WIDEST` degrees, and across the longer
    side, with either focal length, at least :data:`NARROWEST`. The principal point is at most a
    photograph's size away from the photograph, and not in its first pixel, where fractions lie.

    Args:
        fractions: Whether the file has fractions of width and height, as in RealEstate10K, not
            pixels.

    Raises:
        InputError: If they are not; the message gives the number in the file and its probable unit.
    """
    width, height = camera.width, camera.height
    size = f"{width}x{height} pixels"
    unit = "fractions of width and height" if fractions else "pixels"
    for axis, focal, side in (("x", camera.K[0, 0], width), ("y", camera.K[1, 1], height)):
        stated = focal / side if fractions else focal
        sides = (side, max(width, height))
        view, longest_view = (math.degrees(2 * math.atan2(s / 2, focal)) for s in sides)
        if view > WIDEST:
            is_fraction = not fractions and stated < LEAST_MILLIMETRES
            likely = "a fraction of the size" if is_fraction else "in millimetres"
        elif longest_view < NARROWEST:
            likely = "in pixels" if fractions else "of a larger photograph, or in micrometres"
        else:
            continue
        raise InputError(
            f"focal length {axis} is {stated:.6g}, for {size} a field of view of {view:.3g} "
            f"degrees, expected {NARROWEST:g} to {WIDEST:g}; it is likely {likely}, give it in "
            f"{unit}"
        )
    x, y = camera.K[:2, 2]
    if not (-width <= x <= 2 * width and -height <= y <= 2 * height):
        likely = "in pixels" if fractions else "of a larger photograph"
    elif not fractions and 0 <= x < 1 and 0 <= y < 1 and min(width, height) > 2:
        likely = "a fraction of the size"
    else:
        return camera
    stated_x, stated_y = (x / width, y / height) if fractions else (x, y)
    raise InputError(
        f"principal point is ({stated_x:.6g}, {stated_y:.6g}), far from the middle of {size}; it "
        f"is likely {likely}, give it in {unit}"
    )
