"""Scores: plain float64 functions of arrays, each with its protocol stated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from skimage.metrics import structural_similarity


def iou(predicted: np.ndarray, truth: np.ndarray) -> float:
    """Intersection over union of two bool masks of one shape; 1.0 if both are empty."""
    union = np.count_nonzero(predicted | truth)
    return float(np.count_nonzero(predicted & truth) / union) if union else 1.0


def boundary_iou(predicted: np.ndarray, truth: np.ndarray) -> float:
    """Boundary IoU of two bool masks [H, W]; 1.0 if both are empty.

    It is the IoU of the pixels of each mask within 0.02 of the image diagonal of its outline, which
    measures the outline independently of the area (Cheng et al., CVPR 2021, arXiv:2103.16562).
    """
    side = 2 * max(1, round(0.02 * math.hypot(*truth.shape))) + 1
    square = np.ones((side, side), np.uint8)

    def rim(mask: np.ndarray) -> np.ndarray:
        border = {"borderType": cv2.BORDER_CONSTANT, "borderValue": 0}  # the image's edge counts
        return mask & (cv2.erode(mask.view(np.uint8), square, **border) == 0)

    return iou(rim(predicted), rim(truth))


def overlap(predicted: np.ndarray, truth: np.ndarray) -> dict[str, Any]:
    """Compute :func:`iou` and :func:`boundary_iou`, by name."""
    return {"iou": iou(predicted, truth), "boundary_iou": boundary_iou(predicted, truth)}


def class_ious(labels: np.ndarray, truths: Sequence[np.ndarray]) -> list[float | None]:
    """Compute the IoU of each class of a closed-set segmentation (3D-OVS, arXiv:2305.14093).

    A pixel without a label counts against the class predicted there. The mean over classes, frames
    and scenes is mIoU (:mod:`slgaussian.benchmark.scores`).

    Args:
        labels: int [H, W]. ``k + 1`` where class ``k`` wins, 0 where none does.
        truths: sequence of bool [H, W]. The mask of each class; masks may overlap.

    Returns:
        One per class; None for a class with an empty true mask, which is not a sample.
    """
    return [iou(labels == k + 1, truth) if truth.any() else None for k, truth in enumerate(truths)]


def exact_accuracy(labels: np.ndarray, truths: Sequence[np.ndarray]) -> float:
    """Compute the fraction of pixels with all classes correct (3D-OVS, arXiv:2305.14093).

    This is scikit-learn's multilabel accuracy: the pixel must belong to exactly one true class, and
    that class must win. Arguments are those of :func:`class_ious`; pixels with the label -1 do not
    count.
    """
    right = np.zeros(labels.shape, bool)
    claims = np.zeros(labels.shape, np.int32)
    for k, truth in enumerate(truths, start=1):
        right |= (labels == k) & truth
        claims += truth
    known = int(np.count_nonzero(labels >= 0))
    return float(np.count_nonzero(right & (claims == 1)) / max(known, 1))


def point_in_mask(point: tuple[float, float] | None, mask: np.ndarray) -> bool:
    """Tell whether the pixel that contains ``point`` (x, y) is set; False for no point."""
    if point is None:
        return False
    x, y = map(math.floor, point)
    return 0 <= y < mask.shape[0] and 0 <= x < mask.shape[1] and bool(mask[y, x])


def point_in_boxes(point: tuple[float, float] | None, boxes: np.ndarray) -> bool:
    """Tell whether ``point``, if any, is in a box [n, 4] (x0, y0, x1, y1), bounds included."""
    if point is None:
        return False
    return bool(((boxes[:, :2] <= point) & (point <= boxes[:, 2:])).all(1).any())


def any_in_boxes(mask: np.ndarray, boxes: np.ndarray) -> bool:
    """Tell whether any set pixel of a bool mask [H, W] is in a box [n, 4], bounds included.

    LangSplat calls one pixel of maximal relevancy a hit, though they may cover a whole wall.
    """
    points = np.argwhere(mask)[:, None, ::-1]
    return bool(((boxes[:, :2] <= points) & (points <= boxes[:, 2:])).all(2).any())


def depth_errors(
    predicted: np.ndarray, truth: np.ndarray, disparity_scale: float | None = None
) -> dict[str, float]:
    """Compute depth errors over all pixels with known true depth (above 0).

    A pixel without a prediction (0) has an error of its full depth.

    Args:
        predicted, truth: float [H, W]. z-depth in one unit, 0 = none.
        disparity_scale: Focal length in pixels times baseline of a rectified pair.

    Returns:
        ``abs_rel`` mean of ``|d - t| / t``; ``delta125`` fraction with ``max(d/t, t/d) < 1.25``;
        with a disparity scale, ``bad2`` fraction with a disparity error above 2 px, as in the
        Middlebury stereo benchmark. Empty if no true depth is known.
    """
    is_known = truth > 0
    if not is_known.any():
        return {}
    d, t = (depth[is_known].astype(np.float64) for depth in (predicted, truth))
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


def psnr(image: np.ndarray, reference: np.ndarray, opaque: np.ndarray | None = None) -> float:
    """Compute the peak signal-to-noise ratio in dB of two uint8 images; infinite if equal.

    Only pixels in ``opaque``, bool [H, W], count, if it is given; it must have some.
    """
    if opaque is not None:
        image, reference = image[opaque], reference[opaque]
    error = np.mean((image.astype(np.float64) - reference.astype(np.float64)) ** 2)
    return float(10 * np.log10(255.0**2 / error)) if error else float("inf")


def ssim(image: np.ndarray, reference: np.ndarray, opaque: np.ndarray | None = None) -> float:
    """Compute the structural similarity of two uint8 RGB images (Wang et al. 2004), sigma 1.5.

    With ``opaque``, bool [H, W] with some pixels, others are those of ``image`` and not averaged.
    """
    window = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    window |= {"data_range": 255.0, "channel_axis": 2}
    if opaque is not None:
        reference = np.where(opaque[..., None], reference, image)
    images = image.astype(np.float64), reference.astype(np.float64)
    mean, full = structural_similarity(*images, full=True, **window)
    return float(mean if opaque is None else full[opaque].mean())
