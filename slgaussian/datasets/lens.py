"""Photographs straightened: what a pinhole camera would have seen where a lens bent the rays.

A lens is two maps, float32 [H, W] each: the column and the row of the stored photograph, in
OpenCV's count from pixel centres, that each pixel of the straight one shows.
"""

from __future__ import annotations

import cv2
import numpy as np

from slgaussian.formats.resampling import sample_depth

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


def straightened(
    image: np.ndarray, depth: np.ndarray | None, maps: Maps
) -> tuple[np.ndarray, np.ndarray | None]:
    """Straighten a photograph uint8 [H, W, 3] and its depth float32 [H, W] or None.

    Colours are interpolated, depths as :func:`slgaussian.formats.resampling.sample_depth` has it;
    what the lens did not see is black, with depth 0.
    """
    columns, rows = unfolded(*maps)
    image = cv2.remap(image, columns, rows, cv2.INTER_LINEAR)
    return image, None if depth is None else sample_depth(depth, columns + 0.5, rows + 0.5)


def straight_mask(mask: np.ndarray | None, maps: Maps) -> np.ndarray | None:
    """Straighten a mask bool [H, W] of a photograph: where it covers more than half of a pixel.

    None stays None.
    """
    if mask is None:
        return None
    return cv2.remap(mask.astype(np.float32), *unfolded(*maps), cv2.INTER_LINEAR) > 0.5


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
    seen = (parts == middle) & (upright > 0)
    return (
        np.where(seen, columns, np.float32(OUTSIDE)),
        np.where(seen, rows, np.float32(OUTSIDE)),
    )
