"""Non-maximum suppression of boxes and masks, by overlap, nesting and visibility."""

from __future__ import annotations

import numpy as np
import torch

INSIDE = 0.85
"""Share of a mask inside another one from which it counts as nested."""

BLOCK = 1 << 26
"""Scratch bytes of one step of a blocked computation."""


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


def mask_nms(
    masks: np.ndarray, scores: np.ndarray, iou: float, nested: float | None = None
) -> np.ndarray:
    """Matrix non-maximum suppression: return indices int64 [K] of the selected masks, best first.

    A mask is suppressed if its IoU with a better one is above ``iou``. With ``nested``, it is also
    suppressed if at least 85 % of it lies inside any other mask of which it covers less than the
    share ``nested``. Empty masks are suppressed. Suppressed masks suppress others as well, so that
    all pairs are independent. Of equal scores the earlier mask is better.

    With an IoU of 0.8 and ``nested`` of 0.5 these are the rules of LangSplat's preprocessing (Qin
    et al., CVPR 2024), except for its behaviour when no mask is left.

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
    # Row i, column j: mask i suppresses mask j.
    better = np.triu(np.ones(shared.shape, bool), 1)
    gone |= (better & (shared > iou * (area[:, None] + area - shared))).any(0)
    if nested is not None:
        inside = (shared >= INSIDE * area) & (shared < nested * area[:, None])
        gone |= inside.any(0)
    return order[~gone]


def mask_intersections(masks: np.ndarray) -> np.ndarray:
    """Count the shared pixels of all pairs of masks bool [M, H, W], integers as float64 [M, M].

    A matrix product of the flattened masks, exact for any number of threads. Pixels that all masks
    treat alike are multiplied once and weighted by their count: masks of photographs have some
    10,000 kinds of pixels, noise as many as there are pixels.
    """
    count = len(masks)
    pixels = int(np.prod(masks.shape[1:]))
    out = torch.zeros(count, count, dtype=torch.float64)
    if count == 0 or pixels == 0:
        return out.numpy()
    kinds, weights = _kinds(masks.reshape(count, pixels))
    # Sums of integers are exact in float32 up to 2^24.
    number = torch.float32 if pixels < 1 << 24 else torch.float64
    step = max(1, BLOCK // (8 * count))
    for start in range(0, len(kinds), step):
        bits = np.unpackbits(kinds[start : start + step], axis=1, count=count)
        part = torch.from_numpy(bits).to(number)
        weight = torch.from_numpy(weights[start : start + step]).to(number)
        out += part.T @ (part * weight[:, None])
    return out.numpy()


def _kinds(flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distinct columns of bool [M, P] as packed rows uint8 [K, M / 8], and their counts.

    Neighbours are compared first, which leaves few columns to sort.
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
    """Select masks of which larger ones leave at least ``share`` visible; ascending int64 [K].

    Every pixel belongs to the largest mask that contains it (of equals, the earlier); a mask is
    selected if it owns at least that share, 0 to 1, of its pixels. Empty masks are dropped. So
    objects win over their parts: the suppression of small objects of DEVA, used by Gaussian
    Grouping (Ye et al., ECCV 2024).
    """
    areas = masks.sum((1, 2))
    winner = np.full(masks.shape[1:], -1)
    for mask in np.lexsort((-np.arange(len(masks)), areas)):
        winner[masks[mask]] = mask
    won = np.bincount(winner[winner >= 0], minlength=len(masks))
    return np.flatnonzero((areas > 0) & (won >= share * areas))
