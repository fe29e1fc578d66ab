"""Undistortion of photographs to a pinhole camera, and the check of its intrinsics.

A lens is represented by two maps, float32 [H, W]: for each pixel of the undistorted photograph, its
column and row in the stored photograph, with pixel centres at integers as in OpenCV.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from slgaussian.errors import InputError
from slgaussian.formats.resampling import sample_depth
from slgaussian.scene import Camera, View

OUTSIDE = -1e4  # column and row of pixels outside the lens's image, which makes them unknown
MIN_FIELD_OF_VIEW, MAX_FIELD_OF_VIEW = 3.0, 175.0  # range of plausible fields of view, degrees

Maps = tuple[np.ndarray, np.ndarray]


def lens_maps(
    K: np.ndarray, size: tuple[int, int], distortion: Sequence[float], fisheye: bool = False
) -> Maps:
    """Compute the maps of a lens; the undistorted photograph has the same intrinsics.

    Args:
        K: float64 [3, 3]
        size: (width, height)
        distortion: sequence of float. OpenCV's coefficients, the first of k1, k2, p1, p2, k3 to k6,
            or with ``fisheye`` of k1 to k4; others are 0.
    """
    centred = K.copy()
    centred[:2, 2] -= 0.5  # OpenCV counts from pixel centres
    undistort = cv2.fisheye.initUndistortRectifyMap if fisheye else cv2.initUndistortRectifyMap
    lens = np.zeros(4 if fisheye else 8)
    lens[: len(distortion)] = distortion
    return undistort(centred, lens, np.eye(3), centred, size, cv2.CV_32FC1)


def undistort(view: View, maps: Maps) -> View:
    """Undistort a view.

    Colours are interpolated, depths by :func:`slgaussian.formats.resampling.sample_depth`, and a
    pixel is opaque if more than half of it is. What the stored photograph does not show, beyond its
    edge or beyond the fold of the lens, is unknown: black, not opaque, with depth 0. Object ids are
    dropped.
    """
    columns, rows = unfold(*maps)
    height, width = columns.shape
    shown = (columns >= -0.5) & (columns < width - 0.5) & (rows >= -0.5) & (rows < height - 0.5)

    def sample(pixels: np.ndarray) -> np.ndarray:
        # The outer half of an edge pixel has its colour.
        return cv2.remap(pixels, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    depth, image = view.depth, sample(view.image)
    image[~shown] = 0
    if depth is not None:
        depth = sample_depth(depth, columns + 0.5, rows + 0.5)
    if view.opaque is not None:
        shown &= sample(view.opaque.astype(np.float32)) > 0.5
    opaque = None if shown.all() else shown
    return replace(view, image=image, depth=depth, opaque=opaque, instances=None)


def unfold(columns: np.ndarray, rows: np.ndarray) -> Maps:
    """Return the maps without the invalid region where the distortion polynomial folds back.

    Beyond the fold it would show the image a second time, mirrored. The Jacobian determinant is not
    positive there; only pixels connected with the centre by a positive determinant are valid.
    """
    (dx_dv, dx_du), (dy_dv, dy_du) = np.gradient(columns), np.gradient(rows)
    upright = (dx_du * dy_dv > dx_dv * dy_du).astype(np.uint8)  # False for NaN
    if upright.all():
        return columns, rows
    parts = cv2.connectedComponents(upright, connectivity=4)[1]
    middle = parts[columns.shape[0] // 2, columns.shape[1] // 2]
    visible, outside = (parts == middle) & (upright > 0), np.float32(OUTSIDE)
    return np.where(visible, columns, outside), np.where(visible, rows, outside)


def checked_camera(camera: Camera, fractions: bool = False) -> Camera:
    """Return a camera unchanged if its intrinsics are plausible; every reader calls this.

    The field of view across each side is at most :data:`MAX_FIELD_OF_VIEW` degrees, and across the
    longer side, with either focal length, at least :data:`MIN_FIELD_OF_VIEW`. The principal point
    is at most a photograph's size away from the photograph, and not in its first pixel, where
    fractions lie.

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
        if view > MAX_FIELD_OF_VIEW or longest_view < MIN_FIELD_OF_VIEW:
            raise InputError(
                f"focal length {axis} is {focal / side if fractions else focal:.6g}, for "
                f"{width}x{height} pixels a field of view of {view:.3g} degrees, expected "
                f"{MIN_FIELD_OF_VIEW:g} to {MAX_FIELD_OF_VIEW:g}; give it in {unit}"
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
