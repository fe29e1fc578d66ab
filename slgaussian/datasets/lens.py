"""Photographs straightened: what a pinhole camera would have seen where a lens bent the rays.

A lens is two maps, float32 [H, W] each: the column and the row of the stored photograph, in
OpenCV's count from pixel centres, that each pixel of the straight one shows.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from slgaussian.formats.resampling import sample_depth
from slgaussian.scene import View

OUTSIDE = -1e4
"""Column and row of what the lens did not see, which makes it black."""

Maps = tuple[np.ndarray, np.ndarray]


def perspective_maps(K: np.ndarray, size: tuple[int, int], lens: np.ndarray) -> Maps:
    """Compute the maps of OpenCV's lens k1, k2, p1, p2, k3 before a camera K [3, 3].

    The straight photograph has the same K.
    """
    centred = K.copy()
    centred[:2, 2] -= 0.5  # OpenCV counts from pixel centres
    return cv2.initUndistortRectifyMap(centred, lens, None, centred, size, cv2.CV_32FC1)


def straightened(view: View, maps: Maps) -> View:
    """Straighten a view as it is stored.

    Colours are interpolated, depths as :func:`slgaussian.formats.resampling.sample_depth` has it,
    and a pixel is opaque where more than half of it is. What the lens did not see is black, with
    depth 0. Object ids are left out.
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
    """Return the maps without what a polynomial makes up beyond the image circle.

    A distortion polynomial holds where it was fitted. Farther out it may turn back and show the
    picture a second time, mirrored; whatever lies behind such a fold, where the determinant of the
    map's derivative is not positive, is not connected with the middle and is taken as not seen.
    """
    (dx_dv, dx_du), (dy_dv, dy_du) = np.gradient(columns), np.gradient(rows)
    upright = (dx_du * dy_dv > dx_dv * dy_du).astype(np.uint8)  # NaN is not
    if upright.all():
        return columns, rows
    parts = cv2.connectedComponents(upright, connectivity=4)[1]
    middle = parts[columns.shape[0] // 2, columns.shape[1] // 2]
    visible = (parts == middle) & (upright > 0)
    return (
        np.where(visible, columns, np.float32(OUTSIDE)),
        np.where(visible, rows, np.float32(OUTSIDE)),
    )
