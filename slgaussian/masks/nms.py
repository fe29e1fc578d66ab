"""Suppression of masks by the IoU of their boxes, and by the coverage of larger masks."""

from __future__ import annotations

import numpy as np


def mask_boxes(masks: np.ndarray) -> np.ndarray:
    """Compute bounding boxes int32 [M, 4] of masks bool [M, H, W]: left, top, right, bottom.

    In pixels, with exclusive right and bottom. The box of an empty mask is four zeros.
    """
    sides = []
    for axis in (1, 2):
        hit = np.any(masks, axis=axis)
        first, last = hit.argmax(1), hit.shape[1] - hit[:, ::-1].argmax(1)
        sides.append(np.where(hit.any(1), (first, last), 0))
    (left, right), (top, bottom) = sides
    return np.stack([left, top, right, bottom], 1).astype(np.int32)


def box_nms(boxes: np.ndarray, scores: np.ndarray, iou: float) -> np.ndarray:
    """Greedy non-maximum suppression: return indices int64 [K] of the selected boxes, best first.

    A box is suppressed if its IoU with a better selected box is above ``iou``; of equal scores the
    earlier box is better. Boxes [M, 4] are those of :func:`mask_boxes`; the IoU of two boxes
    without area is 0.
    """
    order = np.argsort(-scores, kind="stable")
    left, top, right, bottom = boxes[order].astype(np.float64).T
    area = (right - left) * (bottom - top)
    alive = np.ones(len(order), bool)
    kept_ranks = []
    for rank in range(len(order)):
        if not alive[rank]:
            continue
        kept_ranks.append(rank)
        rest = rank + 1 + np.flatnonzero(alive[rank + 1 :])
        width = np.minimum(right[rank], right[rest]) - np.maximum(left[rank], left[rest])
        height = np.minimum(bottom[rank], bottom[rest]) - np.maximum(top[rank], top[rest])
        shared = np.maximum(width, 0) * np.maximum(height, 0)
        alive[rest[shared > iou * (area[rank] + area[rest] - shared)]] = False
    return order[kept_ranks]


def mostly_visible(masks: np.ndarray, share: float) -> np.ndarray:
    """Select masks that larger masks leave visible by at least ``share``; ascending int64 [K].

    Every pixel belongs to the largest mask that contains it (of equals, the earlier); a mask is
    selected if at least the fraction ``share`` of its pixels belong to it. Empty masks are dropped.
    Objects thus take precedence over their parts: this is the small-object suppression of DEVA, as
    used by Gaussian Grouping (Ye et al., ECCV 2024).
    """
    areas = masks.sum((1, 2))
    winner = np.full(masks.shape[1:], -1)
    for mask in np.lexsort((-np.arange(len(masks)), areas)):
        winner[masks[mask]] = mask
    visible = np.bincount(winner[winner >= 0], minlength=len(masks))
    return np.flatnonzero((areas > 0) & (visible >= share * areas))
