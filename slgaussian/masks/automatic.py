"""Automatic mask generation with a promptable model: a grid of points, then filters.

The steps are those of Kirillov et al., "Segment Anything", ICCV 2023, section 5 and appendix B;
:data:`slgaussian.masks.configs.PRESETS` has the settings of three programs that use them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np
import torch

from slgaussian.masks import Proposals
from slgaussian.masks.configs import LEVELS, Automatic
from slgaussian.masks.nms import box_nms, mask_boxes, mostly_visible

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

    A score is predicted IoU times stability. ``encode`` encodes the image; for the other arguments
    see :class:`slgaussian.masks.prompted.AutomaticProposer`.
    """
    height, width = size = image.shape[:2]
    points = point_grid(height, width, settings.points)
    if region is not None:
        column, row = points.astype(int).T
        points = points[region[row, column]]
    level_indices = [LEVELS.index(level) for level in levels]
    parts: list[_Candidates] = []
    if len(points):
        prompted = encode(image)
        for start in range(0, len(points), batch):
            prompts = points[start : start + batch]
            parts.extend(_mask_prompts(prompted, prompts, size, settings, level_indices))
    if not parts:
        return Proposals(np.zeros((0, *size), bool), np.zeros(0, np.float32))
    candidates = _Candidates.join(parts)
    rows = box_nms(candidates.boxes, candidates.predicted_iou, settings.box_iou)
    candidates = candidates[rows]
    masks = np.unpackbits(candidates.packed, axis=1, count=size[0] * size[1])
    masks = masks.view(bool).reshape(-1, *size)
    if settings.visible is not None:
        rows = mostly_visible(masks, settings.visible)
        candidates, masks = candidates[rows], masks[rows]
    scores = candidates.predicted_iou * candidates.stability
    best = np.argsort(-scores, kind="stable")
    return Proposals(masks[best], scores[best].astype(np.float32))


@dataclass(frozen=True)
class _Candidates:
    """M candidate masks, one in each row; bit-packed, since there may be thousands."""

    packed: np.ndarray
    boxes: np.ndarray
    predicted_iou: np.ndarray
    stability: np.ndarray

    def __getitem__(self, rows: np.ndarray) -> _Candidates:
        return _Candidates(*(getattr(self, f.name)[rows] for f in fields(self)))

    @staticmethod
    def join(parts: list[_Candidates]) -> _Candidates:
        names = [f.name for f in fields(_Candidates)]
        return _Candidates(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))


def point_grid(height: int, width: int, count: int) -> np.ndarray:
    """Return the centres of a grid of ``count`` x ``count`` cells, x and y in pixels, float64
    [N, 2]."""
    at = (np.arange(count) + 0.5) / count
    y, x = np.meshgrid(at * height, at * width, indexing="ij")
    return np.stack([x.ravel(), y.ravel()], 1)


def _mask_prompts(
    prompted: PromptedImage,
    points: np.ndarray,
    size: tuple[int, int],
    settings: Automatic,
    level_indices: Sequence[int],
) -> Iterator[_Candidates]:
    """Yield the masks of a batch of points that pass the thresholds."""
    logits, predicted = prompted.segment(points)
    allowed = torch.zeros_like(predicted, dtype=torch.bool)
    allowed[:, level_indices] = True
    point, level = torch.nonzero(allowed & (predicted > settings.predicted_iou), as_tuple=True)
    step = max(1, min(MOST, BLOCK // (4 * size[0] * size[1])))
    for start in range(0, len(point), step):
        chosen = point[start : start + step], level[start : start + step]
        large = prompted.enlarge(logits[chosen])
        inner, outer = ((large > at).sum((1, 2)) for at in (OFFSET, -OFFSET))
        stability = (inner / outer.clamp(min=1)).cpu().numpy()
        inside = (large > 0).cpu().numpy()
        good = (stability >= settings.stability) & inside.any((1, 2))
        yield _Candidates(
            np.packbits(inside[good].reshape(-1, size[0] * size[1]), axis=1),
            mask_boxes(inside[good]),
            predicted[chosen].cpu().numpy()[good],
            stability[good],
        )
