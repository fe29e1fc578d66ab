"""Which of many overlapping masks to keep: by boxes, by masks, by what hides or holds them."""

from __future__ import annotations

import numpy as np
import torch

INSIDE = 0.85
"""A mask of which at least this share lies in another one is inside it."""

BLOCK = 1 << 26
"""Bytes that a step of a long computation may take beside its input and output."""


def mask_boxes(masks: np.ndarray) -> np.ndarray:
    """Bounding boxes int32 [M, 4] of masks bool [M, H, W]: left, top, right, bottom.

    They are in pixels; right and bottom are the first column and row outside, so that areas are
    products of sides. The box of an empty mask is four zeros.
    """
    sides = []
    for axis in (1, 2):
        hit = np.any(masks, axis=axis)
        first, last = hit.argmax(1), hit.shape[1] - hit[:, ::-1].argmax(1)
        sides.append(np.where(hit.any(1), (first, last), 0))
    (left, right), (top, bottom) = sides
    return np.stack([left, top, right, bottom], 1).astype(np.int32)


def box_nms(boxes: np.ndarray, scores: np.ndarray, iou: float) -> np.ndarray:
    """Greedy non-maximum suppression: indices int64 [K] of the boxes to keep, best first.

    From the best score to the worst, a box is kept unless its IoU with a box already kept is above
    ``iou``; of equal scores the earlier box is better. Boxes [M, 4] are as of :func:`mask_boxes`;
    the IoU of two boxes without area is 0.
    """
    order = np.argsort(-scores, kind="stable")
    left, top, right, bottom = boxes[order].astype(np.float64).T
    area = (right - left) * (bottom - top)
    alive = np.ones(len(order), bool)
    kept = []
    for rank in range(len(order)):
        if not alive[rank]:
            continue
        kept.append(rank)
        rest = rank + 1 + np.flatnonzero(alive[rank + 1 :])
        width = np.minimum(right[rank], right[rest]) - np.maximum(left[rank], left[rest])
        height = np.minimum(bottom[rank], bottom[rest]) - np.maximum(top[rank], top[rest])
        shared = np.maximum(width, 0) * np.maximum(height, 0)
        alive[rest[shared > iou * (area[rank] + area[rest] - shared)]] = False
    return order[kept]


def mask_nms(
    masks: np.ndarray, scores: np.ndarray, iou: float, nested: float | None = None
) -> np.ndarray:
    """Indices int64 [K] of the masks to keep, best first, without a loop over pairs.

    A mask goes if its IoU with a better one is above ``iou``. With ``nested``, it also goes if it
    lies inside another one, better or not, with at least 85 % of itself, and is less than the share
    ``nested`` of that other one. Empty masks go. A mask has its effect whether it stays itself or
    not: so each pair is judged on its own, and all of them at once. Of equal scores the earlier
    mask is better.

    With an IoU of 0.8 and ``nested`` of 0.5 these are the rules by which LangSplat thins SAM's
    masks (Qin et al., CVPR 2024, in its preprocessing), apart from what it does if none is left.

    Parameters
    ----------
    masks : bool [M, H, W]
    scores : float [M]
    iou : float
        0 to 1.
    nested : float or None
        0 to 1.
    """
    order = np.argsort(-scores, kind="stable")
    shared = mask_intersections(masks)[order[:, None], order]
    area = shared.diagonal().copy()
    gone = area == 0
    # In row i and column j, does mask i rule out mask j?
    better = np.triu(np.ones(shared.shape, bool), 1)
    gone |= (better & (shared > iou * (area[:, None] + area - shared))).any(0)
    if nested is not None:
        inside = (shared >= INSIDE * area) & (shared < nested * area[:, None])
        gone |= inside.any(0)
    return order[~gone]


def mask_intersections(masks: np.ndarray) -> np.ndarray:
    """Pixels that every two masks share, float64 [M, M] of whole numbers, from bool [M, H, W].

    It is a matrix product of the flattened masks, exact and the same for any number of threads.
    Pixels in which all masks are alike are multiplied once and weighed by their count: of
    photographs, where masks have smooth borders, there are some 10,000 kinds, of noise as many as
    pixels.
    """
    count = len(masks)
    pixels = int(np.prod(masks.shape[1:]))
    out = torch.zeros(count, count, dtype=torch.float64)
    if count == 0 or pixels == 0:
        return out.numpy()
    kinds, weights = _kinds(masks.reshape(count, pixels))
    # Sums of whole numbers, exact in float32 up to here.
    number = torch.float32 if pixels < 1 << 24 else torch.float64
    step = max(1, BLOCK // (8 * count))
    for start in range(0, len(kinds), step):
        bits = np.unpackbits(kinds[start : start + step], axis=1, count=count)
        part = torch.from_numpy(bits).to(number)
        weight = torch.from_numpy(weights[start : start + step]).to(number)
        out += part.T @ (part * weight[:, None])
    return out.numpy()


def _kinds(flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Different columns of bool [M, P], as packed rows uint8 [K, M / 8], and how often they occur.

    Neighbours are compared first, since that leaves little to sort.
    """
    count, pixels = flat.shape
    starts = np.zeros(pixels, bool)
    starts[0] = True
    for row in flat:
        starts[1:] |= row[1:] != row[:-1]
    starts = np.flatnonzero(starts)
    lengths = np.diff(np.append(starts, pixels))
    packed = np.empty((len(starts), -(-count // 8)), np.uint8)
    step = max(1, BLOCK // count)
    for start in range(0, len(starts), step):
        packed[start : start + step] = np.packbits(flat[:, starts[start : start + step]], axis=0).T
    rows = packed.view(np.dtype((np.void, packed.shape[1])))[:, 0]
    _, first, kind = np.unique(rows, return_index=True, return_inverse=True)
    return packed[first], np.bincount(kind, weights=lengths)


def mostly_visible(masks: np.ndarray, share: float) -> np.ndarray:
    """Indices int64 [K], ascending, of masks of which larger ones leave at least ``share`` visible.

    Every pixel goes to the largest mask that holds it (the earlier one of equally large ones); a
    mask stays if it won at least that share, 0 to 1, of its pixels. Empty masks go. So whole
    objects win over their parts: DEVA's suppression of small objects, which Gaussian Grouping uses
    (Ye et al., ECCV 2024).
    """
    areas = masks.sum((1, 2))
    winner = np.full(masks.shape[1:], -1)
    for mask in np.lexsort((-np.arange(len(masks)), areas)):
        winner[masks[mask]] = mask
    won = np.bincount(winner[winner >= 0], minlength=len(masks))
    return np.flatnonzero((areas > 0) & (won >= share * areas))
