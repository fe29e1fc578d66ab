"""Undistortion of photographs to a pinhole camera.

A lens is represented by two maps, float32 [H, W]: for each pixel of the undistorted photograph, its
column and row in the stored photograph, with pixel centres at integers as in OpenCV.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from slgaussian.formats.resampling import sample_depth
from slgaussian.scene import View

OUTSIDE = -1e4
"""Column and row of pixels outside the lens's image, which makes them black."""

Maps = tuple[np.ndarray, np.ndarray]


def perspective_maps(K: np.ndarray, size: tuple[int, int], lens: np.ndarray) -> Maps:
    """Compute the maps of a lens with OpenCV's coefficients k1, k2, p1, p2, k3.

    The undistorted photograph has the same intrinsics ``K`` [3, 3].
    """
    centred = K.copy()
    centred[:2, 2] -= 0.5  # OpenCV counts from pixel centres
    return cv2.initUndistortRectifyMap(centred, lens, None, centred, size, cv2.CV_32FC1)


def straightened(view: View, maps: Maps) -> View:
    """Undistort a view.

    Colours are interpolated, depths by :func:`slgaussian.formats.resampling.sample_depth`, and a
    pixel is opaque if more than half of it is. Pixels outside the lens's image are black, with
    depth 0. Object ids are dropped.
    """
    columns, rows = unfolded(*maps)
    depth, opaque = view.depth, view.opaque
    if depth is not None:
        depth = sample_depth(depth, columns + 0.5, rows + 0.5)
    if opaque is not None:
        opaque = cv2.remap(opaque.astype(np.float32), columns, rows, cv2.INTER_LINEAR) > 0.5
    image = cv2.remap(view.image, columns, rows, cv2.INTER_LINEAR)
    return replace(view, image=image, depth=depth, opaque=opaque, instances=None)


def unfolded(columns: np.ndarray, rows: np.ndarray) -> Maps:
    """Return the maps without the invalid region where the distortion polynomial folds back.

    A distortion polynomial is valid where it was fitted. Farther out it may fold back and show the
    image a second time, mirrored. At a fold the Jacobian determinant of the map is not positive;
    pixels not connected with the centre by a positive determinant are marked as outside.
    """
    (dx_dv, dx_du), (dy_dv, dy_du) = np.gradient(columns), np.gradient(rows)
    upright = (dx_du * dy_dv > dx_dv * dy_du).astype(np.uint8)  # False for NaN
    if upright.all():
        return columns, rows
    parts = cv2.connectedComponents(upright, connectivity=4)[1]
    middle = parts[columns.shape[0] // 2, columns.shape[1] // 2]
    visible = (parts == middle) & (upright > 0)
    return (
        np.where(visible, columns, np.float32(OUTSIDE)),
        np.where(visible, rows, np.float32(OUTSIDE)),
    )
