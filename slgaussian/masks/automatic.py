"""All masks of an image from a model that answers prompts: a grid of points, then a sieve.

The steps are those of Kirillov et al., "Segment Anything", ICCV 2023, section 5 and appendix B, and
the numbers of :data:`slgaussian.masks.configs.PRESETS` those of four programs that use them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Protocol

import cv2
import numpy as np
import torch

from slgaussian.masks import Proposals
from slgaussian.masks.configs import LEVELS, Automatic
from slgaussian.masks.nms import box_nms, mask_boxes, mask_nms, mostly_visible

OVERLAP = 512 / 1500
"""Overlap of neighbouring crops of the first layer, as a fraction of the image's short side."""

EDGE = 20
"""Pixels from the edge of a crop within which a mask is taken for cut off by it."""

OFFSET = 1.0
"""A stable mask hardly changes when its logits are cut that much above and below 0."""

BLOCK = 1 << 27
"""Bytes of logits at the image's size that are looked at together, or at least one mask."""

MOST = 32
"""Masks that are looked at together at most, since on the way they may be larger."""


class PromptedImage(Protocol):
    """An image that a model has encoded and can be asked about, as often as wanted."""

    def segment(self, points: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits float32 [P, L, h, w] of the masks at each point, and their predicted IoU [P, L].

        ``points`` float64 [P, 2] are x and y in pixels of the image.
        """

    def enlarge(self, logits: torch.Tensor) -> torch.Tensor:
        """Logits [M, h, w] at the size of the image, float32 [M, H, W]."""


def all_masks(
    encode: Callable[[np.ndarray], PromptedImage],
    image: np.ndarray,
    settings: Automatic,
    where: np.ndarray | None = None,
    levels: Sequence[str] = LEVELS,
    batch: int = 16,
) -> Proposals:
    """Masks of an image uint8 [H, W, 3] and their scores, predicted IoU times stability.

    ``encode`` makes ready an image or a crop of one; for the rest see
    :class:`slgaussian.masks.prompted.AutomaticProposer`. The best score comes first.
    """
    height, width = size = image.shape[:2]
    if where is None:
        where = np.ones(size, bool)
    wanted = [LEVELS.index(level) for level in levels]
    found = []
    for crop in crop_boxes(height, width, settings.crops):
        left, top, right, bottom = crop
        points = point_grid(bottom - top, right - left, settings.points)
        column, row = points.astype(int).T
        points = points[where[top + row, left + column]]
        if len(points) == 0:
            continue
        prompted = encode(np.ascontiguousarray(image[top:bottom, left:right]))
        good = [
            part
            for start in range(0, len(points), batch)
            for part in _answers(
                prompted, points[start : start + batch], crop, size, settings, wanted
            )
        ]
        if good:
            joined = _Candidates.join(good)
            found.append(joined[_thin(joined, settings, joined.predicted_iou)])
    return _sieve(found, settings, size)


@dataclass(frozen=True)
class _Candidates:
    """Masks on their way: M of them, each a row; packed, since there may be thousands."""

    packed: np.ndarray
    boxes: np.ndarray
    predicted_iou: np.ndarray
    stability: np.ndarray
    level: np.ndarray
    crop_area: np.ndarray

    def __getitem__(self, rows: np.ndarray) -> _Candidates:
        return _Candidates(*(getattr(self, f.name)[rows] for f in fields(self)))

    @staticmethod
    def join(parts: list[_Candidates]) -> _Candidates:
        names = [f.name for f in fields(_Candidates)]
        return _Candidates(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))


def crop_boxes(height: int, width: int, layers: int) -> Iterator[tuple[int, int, int, int]]:
    """Left, top, right and bottom of the image itself and of the crops of each layer.

    Layer k has 2^k crops along each side, which overlap by ``OVERLAP`` / 2^(k-1) of the short side.
    """
    yield 0, 0, width, height
    for layer in range(1, layers + 1):
        count = 2**layer
        overlap = int(OVERLAP * min(height, width) * 2 / count)
        wide, high = (-(-(overlap * (count - 1) + side) // count) for side in (width, height))
        for row, column in product(range(count), repeat=2):
            left = min(column * (wide - overlap), width - wide)
            top = min(row * (high - overlap), height - high)
            yield left, top, left + wide, top + high


def point_grid(height: int, width: int, count: int) -> np.ndarray:
    """Centres of ``count`` x ``count`` cells of an image, x and y in pixels, float64 [N, 2]."""
    at = (np.arange(count) + 0.5) / count
    y, x = np.meshgrid(at * height, at * width, indexing="ij")
    return np.stack([x.ravel(), y.ravel()], 1)


def _answers(
    prompted: PromptedImage,
    points: np.ndarray,
    crop: tuple[int, int, int, int],
    size: tuple[int, int],
    settings: Automatic,
    wanted: Sequence[int],
) -> Iterator[_Candidates]:
    """The good masks of a batch of points, placed in the image."""
    left, top, right, bottom = crop
    logits, predicted = prompted.segment(points)
    allowed = torch.zeros_like(predicted, dtype=torch.bool)
    allowed[:, wanted] = True
    point, level = torch.nonzero(allowed & (predicted > settings.predicted_iou), as_tuple=True)
    step = max(1, min(MOST, BLOCK // (4 * (bottom - top) * (right - left))))
    for start in range(0, len(point), step):
        chosen = point[start : start + step], level[start : start + step]
        large = prompted.enlarge(logits[chosen])
        sure, any_ = ((large > at).sum((1, 2)) for at in (OFFSET, -OFFSET))
        stability = (sure / any_.clamp(min=1)).cpu().numpy()
        inside = (large > 0).cpu().numpy()
        boxes = mask_boxes(inside)
        good = (stability >= settings.stability) & inside.any((1, 2))
        good &= ~_cut_off(boxes, crop, size)
        masks = np.zeros((good.sum(), *size), bool)
        masks[:, top:bottom, left:right] = inside[good]
        yield _Candidates(
            _packed(masks),
            boxes[good] + np.array([left, top, left, top], np.int32),
            predicted[chosen].cpu().numpy()[good],
            stability[good],
            chosen[1].cpu().numpy()[good],
            np.full(good.sum(), (bottom - top) * (right - left)),
        )


def _cut_off(
    boxes: np.ndarray, crop: tuple[int, int, int, int], size: tuple[int, int]
) -> np.ndarray:
    """Bool [M]: does a box end at an edge of its crop that is not one of the image?"""
    left, top, right, bottom = crop
    far = np.array([right - left, bottom - top])
    to_crop = np.concatenate([boxes[:, :2], far - boxes[:, 2:]], 1)
    to_image = to_crop + [left, top, size[1] - right, size[0] - bottom]
    return np.any((to_crop <= EDGE) & (to_image > EDGE), axis=1)


def _thin(candidates: _Candidates, settings: Automatic, order: np.ndarray) -> np.ndarray:
    """Rows that box NMS keeps, the best by ``order`` first, level by level where ``apart``."""
    return _by_level(
        candidates.level,
        settings.apart,
        lambda rows: box_nms(candidates.boxes[rows], order[rows], settings.box_iou),
    )


def _by_level(
    level: np.ndarray, apart: bool, kept_of: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """``kept_of`` of the rows of each level, or of all rows, as rows of the whole."""
    groups = [level == number for number in range(len(LEVELS))] if apart else [level >= 0]
    rows = [np.flatnonzero(group) for group in groups]
    return np.concatenate([group[kept_of(group)] for group in rows])


def _sieve(found: list[_Candidates], settings: Automatic, size: tuple[int, int]) -> Proposals:
    """What is left of the masks of all crops when they are compared with each other."""
    if not found:
        return Proposals(np.zeros((0, *size), bool), np.zeros(0, np.float32), np.zeros(0, np.uint8))
    candidates = _Candidates.join(found)
    if settings.crops:
        # What a smaller crop shows, it shows in more detail.
        candidates = candidates[_thin(candidates, settings, -candidates.crop_area.astype(float))]
    masks = _unpacked(candidates.packed, size)
    if settings.smallest:
        changed = np.array([tidy(mask, settings.smallest) for mask in masks], bool)
        candidates = replace(candidates, boxes=mask_boxes(masks))
        kept = _thin(candidates, settings, (~changed).astype(float))
        candidates, masks = candidates[kept], masks[kept]
    scores = candidates.predicted_iou * candidates.stability
    kept = np.flatnonzero(scores >= settings.score)
    candidates, masks, scores = candidates[kept], masks[kept], scores[kept]
    mask_iou = settings.mask_iou
    if mask_iou is not None:
        kept = _by_level(
            candidates.level,
            settings.apart,
            lambda rows: mask_nms(masks[rows], scores[rows], mask_iou, settings.nested),
        )
        candidates, masks, scores = candidates[kept], masks[kept], scores[kept]
    if settings.visible is not None:
        kept = mostly_visible(masks, settings.visible)
        candidates, masks, scores = candidates[kept], masks[kept], scores[kept]
    best = np.argsort(-scores, kind="stable")
    levels = candidates.level[best].astype(np.uint8)
    return Proposals(masks[best], scores[best].astype(np.float32), levels)


def tidy(mask: np.ndarray, smallest: int) -> bool:
    """Fill holes and remove islands of fewer than ``smallest`` pixels, in place; was there any?

    Pixels that touch at a corner belong together. Of a mask of small islands only, the largest
    stays.
    """
    before = mask.copy()
    for value in (False, True):
        count, pieces, stats, _ = cv2.connectedComponentsWithStats(
            (mask == value).astype(np.uint8), connectivity=8
        )
        small = stats[:, cv2.CC_STAT_AREA] < smallest
        small[0] = False
        if value and small.sum() == count - 1 > 0:
            small[1 + stats[1:, cv2.CC_STAT_AREA].argmax()] = False
        mask[small[pieces]] = not value
    return not np.array_equal(mask, before)


def _packed(masks: np.ndarray) -> np.ndarray:
    return np.packbits(masks.reshape(len(masks), int(np.prod(masks.shape[1:]))), axis=1)


def _unpacked(packed: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    flat = np.unpackbits(packed, axis=1, count=size[0] * size[1])
    return flat.view(bool).reshape(-1, *size)
