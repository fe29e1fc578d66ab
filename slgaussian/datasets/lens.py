"""Undistortion of photographs to a pinhole camera.

A lens is represented by two maps, float32 [H, W]: for each pixel of the undistorted photograph, its
column and row in the stored photograph, with pixel centres at integers as in OpenCV.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from slgaussian.formats.resampling import sample_depth
from slgaussian.scene import View

OUTSIDE = -1e4  # column and row of pixels outside the lens's image, which makes them unknown

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
