"""Boundary IoU: how well the outline of a mask is found, whatever its area.

Cheng et al., Boundary IoU (CVPR 2021, arXiv:2103.16562): the intersection over union of the pixels
of two masks that lie within a distance of their own outline.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from slgaussian.benchmark import metrics

DILATION = 0.02
"""The distance, as a fraction of the image's diagonal."""


def boundary_iou(predicted: np.ndarray, truth: np.ndarray) -> float:
    """Boundary IoU of two bool masks [H, W]; 1.0 if both are empty."""
    return metrics.iou(rim(predicted), rim(truth))


def rim(mask: np.ndarray) -> np.ndarray:
    """The pixels of bool [H, W] with one outside the mask within :func:`reach` of rows and columns.

    What lies beyond the image is outside.
    """
    side = 2 * reach(*mask.shape) + 1
    core = cv2.erode(
        mask.view(np.uint8),
        np.ones((side, side), np.uint8),
        borderType=cv2.BORDER_CONSTANT,
        borderValue=0,
    )
    return mask & (core == 0)


def reach(height: int, width: int) -> int:
    """The distance in pixels: 0.02 of the diagonal, rounded, at least 1; 14 at 416 x 576."""
    return max(1, round(DILATION * math.hypot(height, width)))
