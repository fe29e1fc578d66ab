"""The pixel that represents a region: the centre of its thickest part."""

from __future__ import annotations

import cv2
import numpy as np


def central_point(region: np.ndarray) -> tuple[int, int]:
    """Find the pixel (x, y) = (column, row) of a region that is farthest from its outside.

    It lies in the largest 4-connected component of the bool [H, W] mask and has the largest
    Euclidean distance to the nearest pixel outside, pixels beyond the image included. Distances
    are float32, and any of several equal ones may be taken.
    """
    x, y, w, h = cv2.boundingRect(region.view(np.uint8))
    mask = np.ascontiguousarray(region[y : y + h, x : x + w]).view(np.uint8)
    _, parts, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4, ltype=cv2.CV_32S)
    largest = 1 + stats[1:, cv2.CC_STAT_AREA].argmax()
    left, top, width, height, _ = stats[largest].tolist()
    part = parts[top : top + height, left : left + width] == largest
    inside = np.pad(part.view(np.uint8), 1)
    depth = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    row, column = np.unravel_index(depth.argmax(), depth.shape)
    return x + left + int(column) - 1, y + top + int(row) - 1
