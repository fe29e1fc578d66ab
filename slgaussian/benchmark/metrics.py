"""Scores: plain float64 functions of arrays, each with its protocol stated."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from skimage.metrics import structural_similarity


def iou(predicted: np.ndarray, truth: np.ndarray) -> float:
    """Intersection over union of two bool masks of one shape; 1.0 if both are empty."""
    union = np.count_nonzero(predicted | truth)
    return float(np.count_nonzero(predicted & truth) / union) if union else 1.0


DILATION = 0.02
"""The distance, of :func:`boundary_iou`, as a fraction of the image's diagonal."""


def boundary_iou(predicted: np.ndarray, truth: np.ndarray) -> float:
    """Boundary IoU of two bool masks [H, W]; 1.0 if both are empty.

    The IoU of the pixels of each that lie within a distance of its own outline: how well that is
    found, whatever the area (Cheng et al., CVPR 2021, arXiv:2103.16562).
    """
    return iou(rim(predicted), rim(truth))


def rim(mask: np.ndarray) -> np.ndarray:
    """Return the pixels of bool [H, W] with one outside it within :func:`reach` pixels.

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
    """Return the distance in pixels: 0.02 of the diagonal, rounded, at least 1; 14 at 416 x 576."""
    return max(1, round(DILATION * math.hypot(height, width)))


def class_ious(labels: np.ndarray, truths: Sequence[np.ndarray]) -> list[float | None]:
    """IoU of every class of a closed-set segmentation (the 3D-OVS protocol, arXiv:2305.14093).

    Each class region of the arg-max map is compared with the class mask over the *whole* image,
    so a pixel that no class labels still counts against the class that claims it.

    Parameters
    ----------
    labels : int [H, W]
        ``k + 1`` where class ``k`` wins, 0 where none does.
    truths : sequence of bool [H, W]
        The mask of each class; masks may overlap.

    Returns
    -------
    list of float or None
        In [0, 1]; None for a class without a pixel in its truth, which is no sample.
    """
    return [iou(labels == k + 1, truth) if truth.any() else None for k, truth in enumerate(truths)]


def exact_accuracy(labels: np.ndarray, truths: Sequence[np.ndarray]) -> float:
    """Fraction of the image's pixels at which every class is told right (3D-OVS, arXiv:2305.14093).

    scikit-learn's accuracy of one bit a class: the pixel's truth has to be one class alone, and
    that one has to win. So a pixel without a label, or with two, is always wrong; and so is one
    where nothing wins, which 3D-OVS gives to some class.

    Parameters are those of :func:`class_ious`.
    """
    right = np.zeros(labels.shape, bool)
    claims = np.zeros(labels.shape, np.int32)
    for k, truth in enumerate(truths):
        right |= (labels == k + 1) & truth
        claims += truth
    return float(np.count_nonzero(right & (claims == 1)) / labels.size)


def point_in_mask(point: tuple[float, float] | None, mask: np.ndarray) -> bool:
    """Tell whether the pixel that holds ``point`` (x, y) is set; False for no point."""
    if point is None:
        return False
    x, y = int(np.floor(point[0])), int(np.floor(point[1]))
    return 0 <= y < mask.shape[0] and 0 <= x < mask.shape[1] and bool(mask[y, x])


def point_in_boxes(point: tuple[float, float] | None, boxes: np.ndarray) -> bool:
    """Tell whether ``point`` lies in any box [n, 4] (x0, y0, x1, y1), bounds included, as LERF.

    False for no point.
    """
    if point is None:
        return False
    x, y = point
    inside = (boxes[:, 0] <= x) & (x <= boxes[:, 2]) & (boxes[:, 1] <= y) & (y <= boxes[:, 3])
    return bool(inside.any())


def any_in_boxes(mask: np.ndarray, boxes: np.ndarray) -> bool:
    """Tell whether any set pixel of a bool mask [H, W] lies in any box [n, 4], as LangSplat counts.

    Of all pixels where relevancy is greatest one is enough, which is lenient: a whole wall may be.
    Bounds are included.
    """
    rows, columns = np.nonzero(mask)
    return any(
        bool(((x0 <= columns) & (columns <= x1) & (y0 <= rows) & (rows <= y1)).any())
        for x0, y0, x1, y1 in boxes
    )


def depth_errors(
    predicted: np.ndarray, truth: np.ndarray, disparity_scale: float | None = None
) -> dict[str, float]:
    """Depth errors over every pixel whose true depth is known (above 0).

    A pixel without a prediction (0) counts as wrong by its whole depth, so a method gains nothing
    by keeping silent.

    Parameters
    ----------
    predicted, truth : float [H, W]
        z-depth in one unit, 0 = none.
    disparity_scale : float, optional
        Focal length in pixels times baseline of a rectified pair: disparity = scale / depth.

    Returns
    -------
    dict
        ``abs_rel`` mean of ``|d - t| / t``; ``delta125`` fraction with ``max(d/t, t/d) < 1.25``;
        with a disparity scale, ``bad2`` fraction whose disparity is more than 2 px off, the measure
        of the Middlebury stereo benchmark. Empty if no true depth is known.
    """
    is_known = truth > 0
    if not is_known.any():
        return {}
    d = predicted[is_known].astype(np.float64)
    t = truth[is_known].astype(np.float64)
    is_predicted = d > 0
    safe = np.where(is_predicted, d, 1.0)
    ratio = np.where(is_predicted, np.maximum(safe / t, t / safe), np.inf)
    errors = {
        "abs_rel": float(np.mean(np.abs(d - t) / t)),
        "delta125": float(np.mean(ratio < 1.25)),
    }
    if disparity_scale is not None:
        shift = np.where(is_predicted, np.abs(disparity_scale / safe - disparity_scale / t), np.inf)
        errors["bad2"] = float(np.mean(shift > 2.0))
    return errors


def psnr(image: np.ndarray, reference: np.ndarray) -> float:
    """Peak signal-to-noise ratio in dB of two uint8 images; infinite if they are equal."""
    error = np.mean((image.astype(np.float64) - reference.astype(np.float64)) ** 2)
    return float(10 * np.log10(255.0**2 / error)) if error else float("inf")


def ssim(image: np.ndarray, reference: np.ndarray) -> float:
    """Structural similarity of two uint8 RGB images, as Wang et al. 2004 define it.

    Gaussian window of sigma 1.5 and 11 pixels, mean over pixels and channels.
    """
    mean = structural_similarity(
        image.astype(np.float64),
        reference.astype(np.float64),
        data_range=255.0,
        channel_axis=2,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
    )
    return float(mean)
