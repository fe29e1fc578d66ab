"""Automatic mask generation with a promptable model: a grid of points, then filters.

The steps are those of Kirillov et al., "Segment Anything", ICCV 2023, section 5 and appendix B;
:data:`slgaussian.masks.configs.PRESETS` has the settings of four programs that use them.
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
"""Distance from the edge of a crop, pixels, within which a mask counts as truncated."""

OFFSET = 1.0
"""Offset of the logit thresholds above and below 0 that define the stability of a mask."""

BLOCK = 1 << 27
"""Bytes of full-size logits that are processed at a time; at least one mask."""

MOST = 32
"""Largest number of masks that are processed at a time, as intermediate results may be larger."""


class PromptedImage(Protocol):
    """An encoded image that can be prompted repeatedly."""

    def segment(self, points: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mask logits float32 [P, L, h, w] at each point and their predicted IoU [P, L].

        ``points`` float64 [P, 2] are x and y in pixels of the image.
        """

    def enlarge(self, logits: torch.Tensor) -> torch.Tensor:
        """Resize logits [M, h, w] to the size of the image, float32 [M, H, W]."""


def all_masks(
    encode: Callable[[np.ndarray], PromptedImage],
    image: np.ndarray,
    settings: Automatic,
    region: np.ndarray | None = None,
    levels: Sequence[str] = LEVELS,
    batch: int = 16,
) -> Proposals:
    """Generate the masks of an image uint8 [H, W, 3], by falling score.

    A score is predicted IoU times stability. ``encode`` encodes an image or a crop; for the other
    arguments see :class:`slgaussian.masks.prompted.AutomaticProposer`.
    """
    height, width = size = image.shape[:2]
    if region is None:
        region = np.ones(size, bool)
    wanted = [LEVELS.index(level) for level in levels]
    per_crop = []
    for crop in crop_boxes(height, width, settings.crops):
        left, top, right, bottom = crop
        points = point_grid(bottom - top, right - left, settings.points)
        column, row = points.astype(int).T
        points = points[region[top + row, left + column]]
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
            per_crop.append(joined[_thin(joined, settings, joined.predicted_iou)])
    return _sieve(per_crop, settings, size)


@dataclass(frozen=True)
class _Candidates:
    """M candidate masks, one in each row; bit-packed, since there may be thousands."""

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
    """Yield left, top, right and bottom of the full image and of the crops of each layer.

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
    """Return the centres of a grid of ``count`` x ``count`` cells, x and y in pixels, float64
    [N, 2]."""
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
    """Yield the masks of a batch of points that pass the thresholds, in image coordinates."""
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
    """Return whether each box ends at an edge of its crop that is no image edge, bool [M]."""
    left, top, right, bottom = crop
    far = np.array([right - left, bottom - top])
    to_crop = np.concatenate([boxes[:, :2], far - boxes[:, 2:]], 1)
    to_image = to_crop + [left, top, size[1] - right, size[0] - bottom]
    return np.any((to_crop <= EDGE) & (to_image > EDGE), axis=1)


def _thin(candidates: _Candidates, settings: Automatic, order: np.ndarray) -> np.ndarray:
    """Return the rows that box NMS keeps, best first, within each level if ``settings.apart``."""
    return _by_level(
        candidates.level,
        settings.apart,
        lambda rows: box_nms(candidates.boxes[rows], order[rows], settings.box_iou),
    )


def _by_level(
    level: np.ndarray, per_level: bool, select: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Apply ``select`` to the rows of each level, or to all rows, and return the selected rows."""
    groups = [level == number for number in range(len(LEVELS))] if per_level else [level >= 0]
    rows = [np.flatnonzero(group) for group in groups]
    return np.concatenate([group[select(group)] for group in rows])


def _sieve(per_crop: list[_Candidates], settings: Automatic, size: tuple[int, int]) -> Proposals:
    """Filter the masks of all crops against each other."""
    if not per_crop:
        return Proposals(np.zeros((0, *size), bool), np.zeros(0, np.float32), np.zeros(0, np.uint8))
    candidates = _Candidates.join(per_crop)
    if settings.crops:
        # Prefer smaller crops, which have more detail.
        candidates = candidates[_thin(candidates, settings, -candidates.crop_area.astype(float))]
    masks = _unpacked(candidates.packed, size)
    if settings.smallest:
        changed = np.array([tidy(mask, settings.smallest) for mask in masks], bool)
        candidates = replace(candidates, boxes=mask_boxes(masks))
        selected = _thin(candidates, settings, (~changed).astype(float))
        candidates, masks = candidates[selected], masks[selected]
    scores = candidates.predicted_iou * candidates.stability
    selected = np.flatnonzero(scores >= settings.score)
    candidates, masks, scores = candidates[selected], masks[selected], scores[selected]
    mask_iou = settings.mask_iou
    if mask_iou is not None:
        selected = _by_level(
            candidates.level,
            settings.apart,
            lambda rows: mask_nms(masks[rows], scores[rows], mask_iou, settings.nested),
        )
        candidates, masks, scores = candidates[selected], masks[selected], scores[selected]
    if settings.visible is not None:
        selected = mostly_visible(masks, settings.visible)
        candidates, masks, scores = candidates[selected], masks[selected], scores[selected]
    best = np.argsort(-scores, kind="stable")
    levels = candidates.level[best].astype(np.uint8)
    return Proposals(masks[best], scores[best].astype(np.float32), levels)


def tidy(mask: np.ndarray, smallest: int) -> bool:
    """Fill holes and remove islands of fewer than ``smallest`` pixels in place; return if any.

    Connectivity is 8. The largest island stays if all are small.
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
