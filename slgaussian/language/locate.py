"""The pixel that represents a region: the centre of its thickest part."""

from __future__ import annotations

import cv2
import numpy as np

ROUNDED = 1e-6
"""Largest relative error of OpenCV's distances, which are float32."""


def central_point(region: np.ndarray) -> tuple[int, int]:
    """Find the pixel (x, y) = (column, row) of a region that is farthest from its outside.

    It lies in the largest 4-connected component of the bool [H, W] mask (of several, the first in
    row-major order) and has the largest Euclidean distance to the nearest pixel outside, pixels
    beyond the image included. Ties go to the first pixel in row-major order.
    """
    x, y, w, h = cv2.boundingRect(region.view(np.uint8))
    part, left, top = _largest_part(region[y : y + h, x : x + w])
    row, column = _deepest(part)
    return int(column) + x + left - 1, int(row) + y + top - 1


def _largest_part(region: np.ndarray) -> tuple[np.ndarray, int, int]:
    """Crop the largest 4-connected component of bool [h, w], the first of equal ones.

    Returns it as uint8 with a border of zeros, and the column and row of the crop.
    """
    _, parts, stats, _ = cv2.connectedComponentsWithStats(
        np.ascontiguousarray(region).view(np.uint8), connectivity=4, ltype=cv2.CV_32S
    )
    areas = stats[1:, cv2.CC_STAT_AREA]
    largest = 1 + np.flatnonzero(areas == areas.max())
    number = largest[0]
    if len(largest) > 1:
        flat = parts.ravel()
        number = flat[np.isin(flat, largest).argmax()]
    left, top, width, height = stats[number, :4]
    part = np.zeros((height + 2, width + 2), np.uint8)
    part[1:-1, 1:-1] = parts[top : top + height, left : left + width] == number
    return part, int(left), int(top)


def _deepest(inside: np.ndarray) -> tuple[int, int]:
    """Find the first pixel, in row-major order, with the largest distance to the outside.

    ``inside`` uint8 [h, w] is 0 along its borders. Squared distances are integers, so pixels that
    OpenCV's rounded distances cannot separate are compared exactly.
    """
    depth = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    greatest = float(depth.max())
    near = np.argwhere(depth >= greatest * (1 - ROUNDED))
    squared = np.rint(depth[near[:, 0], near[:, 1]].astype(np.float64) ** 2)
    if 2 * ROUNDED * greatest**2 > 0.5:
        squared = np.array([_squared_distance(inside, y, x, greatest) for y, x in near.tolist()])
    row, column = near[squared.argmax()]
    return row, column


def _squared_distance(inside: np.ndarray, row: int, column: int, limit: float) -> int:
    """Compute the squared distance to the nearest pixel outside, which is about ``limit`` away."""
    reach = int(limit) + 2
    top, left = max(0, row - reach), max(0, column - reach)
    outside = np.argwhere(inside[top : row + reach + 1, left : column + reach + 1] == 0)
    return int(((outside - (row - top, column - left)) ** 2).sum(1).min())
