"""Intrinsics that no photograph has, as of a file whose numbers are in another unit."""

from __future__ import annotations

import math

from slgaussian.errors import InputError
from slgaussian.scene import Camera

NARROWEST, WIDEST = 3.0, 175.0
"""Degrees of the field of view of a photograph."""

LEAST_MILLIMETRES = 3.0
"""Focal lengths in "pixels" below this are fractions of the photograph, those above millimetres."""


def checked_camera(camera: Camera, fractions: bool = False) -> Camera:
    """Return a camera as a file has it, if a photograph can be of it; every reader calls this.

    The field of view of each side is at most :data:`WIDEST` degrees, and that of the longer side,
    with either focal length, at least :data:`NARROWEST`. The principal point is at most the
    photograph's size away from the photograph.

    Parameters
    ----------
    camera : Camera
    fractions : bool
        Whether the file gives fractions of width and height, as RealEstate10K does, not pixels.

    Raises
    ------
    InputError
        If none can; the message says the file's number and its likely unit.
    """
    width, height = camera.width, camera.height
    expected = "fractions of the photograph's width and height" if fractions else "pixels"
    for axis, (focal, size) in enumerate(
        ((camera.K[0, 0], width), (camera.K[1, 1], height)),
    ):
        stated = focal / size if fractions else focal
        across = _field_of_view(focal, size)
        if across > WIDEST or _field_of_view(focal, max(width, height)) < NARROWEST:
            raise InputError(
                f"focal length {'xy'[axis]} is {stated:.6g}, which for {width}x{height} pixels is "
                f"a field of view of {across:.3g} degrees, expected {NARROWEST:g} to {WIDEST:g}; "
                f"{_likely_unit(stated, across > WIDEST, fractions)}, give it in {expected}"
            )
    center = camera.K[0, 2] / width, camera.K[1, 2] / height
    stated_center = center if fractions else (camera.K[0, 2], camera.K[1, 2])
    is_fraction = (
        not fractions and all(0 <= c < 1 for c in stated_center) and min(width, height) > 2
    )
    if is_fraction or not all(-1 <= c <= 2 for c in center):
        unit = "fractions" if is_fraction else "pixels" if fractions else "of a larger photograph"
        raise InputError(
            f"principal point is ({stated_center[0]:.6g}, {stated_center[1]:.6g}), far from the "
            f"middle of {width}x{height} pixels; it is likely {unit}, give it in {expected}"
        )
    return camera


def _field_of_view(focal: float, size: float) -> float:
    return math.degrees(2 * math.atan(size / 2 / focal))


def _likely_unit(stated: float, is_wide: bool, fractions: bool) -> str:
    if fractions:
        return "it is likely in millimetres" if is_wide else "it is likely in pixels"
    if not is_wide:
        return "it is likely of a larger photograph, or in micrometres"
    return f"it is likely {'in millimetres' if stated >= LEAST_MILLIMETRES else 'a fraction'}"
