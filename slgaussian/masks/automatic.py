"""Automatic mask generation with a promptable model: a grid of points, then filters.

The steps are those of Kirillov et al., "Segment Anything", ICCV 2023, section 5 and appendix B;
:data:`slgaussian.masks.configs.PRESETS` has the settings of three programs that use them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import cv2
import numpy as np
import torch
from pydantic import PrivateAttr

from slgaussian.components.pretrained import Family, load_pretrained
from slgaussian.kernels.threads import inside
from slgaussian.masks import Proposals
from slgaussian.masks.configs import LEVELS, PRESETS, Automatic, AutomaticConfig

if TYPE_CHECKING:
    from slgaussian.geometry import SeenView
    from slgaussian.masks.sam import SamImage

STABILITY_OFFSET = 1.0
"""Offset of the logit thresholds above and below 0 that define the stability of a mask."""

BLOCK_BYTES = 1 << 27
"""Bytes of full-size logits that are processed at a time; at least one mask."""

MAX_MASKS = 32
"""Largest number of masks that are processed at a time, as intermediate results may be larger."""


def all_masks(
    encode: Callable[[np.ndarray], SamImage],
    image: np.ndarray,
    settings: Automatic,
    region: np.ndarray | None = None,
    levels: Sequence[str] = LEVELS,
    batch: int = 16,
) -> Proposals:
    """Generate the masks of an image uint8 [H, W, 3], by falling score.

    A score is predicted IoU times stability. ``encode`` encodes the image; for the other arguments
    see :class:`AutomaticProposer`.
    """
    height, width = size = image.shape[:2]
    centres = (np.arange(settings.points) + 0.5) / settings.points
    points = np.stack(np.meshgrid(centres * width, centres * height), -1).reshape(-1, 2)
    if region is not None:
        column, row = points.astype(int).T
        points = points[region[row, column]]
    level_indices = [LEVELS.index(level) for level in levels]
    parts: list[tuple[np.ndarray, ...]] = []
    if len(points):
        prompted = encode(image)
        for start in range(0, len(points), batch):
            prompts = points[start : start + batch]
            parts.extend(_mask_prompts(prompted, prompts, size, settings, level_indices))
    if not parts:
        return Proposals(np.zeros((0, *size), bool), np.zeros(0, np.float32))
    packed, boxes, predicted_iou, stability = map(np.concatenate, zip(*parts, strict=True))
    rows = np.array(cv2.dnn.NMSBoxes(boxes, predicted_iou, 0.0, settings.box_iou))
    masks = np.unpackbits(packed[rows], axis=1, count=height * width)
    masks = masks.view(bool).reshape(-1, *size)
    scores = (predicted_iou * stability)[rows]
    if settings.visible is not None:
        rows = mostly_visible(masks, settings.visible)
        masks, scores = masks[rows], scores[rows]
    best = np.argsort(-scores, kind="stable")
    return Proposals(masks[best], scores[best].astype(np.float32))


def _mask_prompts(
    prompted: SamImage,
    points: np.ndarray,
    size: tuple[int, int],
    settings: Automatic,
    level_indices: Sequence[int],
) -> Iterator[tuple[np.ndarray, ...]]:
    """Yield masks that pass the thresholds, with boxes, predicted IoU and stability.

    Bit-packed, one in each row, since there may be thousands.
    """
    logits, predicted = prompted.segment(points)
    allowed = torch.zeros_like(predicted, dtype=torch.bool)
    allowed[:, level_indices] = True
    point, level = torch.nonzero(allowed & (predicted > settings.predicted_iou), as_tuple=True)
    step = max(1, min(MAX_MASKS, BLOCK_BYTES // (4 * size[0] * size[1])))
    for start in range(0, len(point), step):
        chosen = point[start : start + step], level[start : start + step]
        large = prompted.enlarge(logits[chosen])
        inner, outer = ((large > at).sum((1, 2)) for at in (STABILITY_OFFSET, -STABILITY_OFFSET))
        stability = (inner / outer.clamp(min=1)).cpu().numpy()
        inside = (large > 0).cpu().numpy()
        good = (stability >= settings.stability) & inside.any((1, 2))
        if not good.any():
            continue
        yield (
            np.packbits(inside[good].reshape(-1, size[0] * size[1]), axis=1),
            np.array([cv2.boundingRect(mask.view(np.uint8)) for mask in inside[good]]),
            predicted[chosen].cpu().numpy()[good],
            stability[good],
        )


class AutomaticProposer(AutomaticConfig, ABC):
    """A mask proposer that prompts a pretrained model with points.

    An image is encoded once, even if the next call has the same image with another ``region``. Time
    grows with the square of ``points``. A prompted point takes 30 to 40 MiB; a batch of 4 takes
    half as long again as one of 16.

    Attributes:
        device: "auto" is "cuda" if available, else "cpu". On a CPU everything is float32; on
            accelerators the image encoder runs in bfloat16, prompts and masks in float32.

    Raises:
        InputError: If a setting is out of range, or the model cannot be loaded
            (:func:`slgaussian.components.pretrained.load_pretrained`).
    """

    FAMILY: ClassVar[Family]

    device: str = "auto"
    _network: Any = PrivateAttr()
    _encoded: tuple[Any, SamImage] | None = PrivateAttr(None)

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        self._network = load_pretrained(self.model, self.FAMILY, self.device)

    @property
    def network(self) -> Any:
        """Model of ``transformers``, on its device."""
        return self._network

    @abstractmethod
    def encode(self, image: np.ndarray) -> SamImage:
        """Encode an image uint8 [H, W, 3] for prompts."""

    def propose(self, frame: SeenView, region: np.ndarray | None = None) -> Proposals:
        """Propose masks for a view; see :class:`slgaussian.masks.MaskProposer`.

        Only grid points in ``region`` are prompted; their masks may extend beyond it. Depth is not
        used. Scores are predicted IoU times stability.
        """
        settings = self.preset if isinstance(self.preset, Automatic) else PRESETS[self.preset]
        if self.points is not None:
            settings = replace(settings, points=self.points)
        levels = LEVELS if self.level == "all" else (self.level,)
        with torch.inference_mode(), inside(self.network):
            return all_masks(self._encode_once, frame.image, settings, region, levels, self.batch)

    def _encode_once(self, image: np.ndarray) -> SamImage:
        content = image.shape, image.tobytes()
        if self._encoded is None or self._encoded[0] != content:
            self._encoded = None
            self._encoded = content, self.encode(image)
        return self._encoded[1]


def mostly_visible(masks: np.ndarray, share: float) -> np.ndarray:
    """Select masks that larger masks leave visible by at least ``share``; ascending int64 [K].

    Every pixel belongs to the largest mask that contains it (of equals, the earlier). Empty masks
    are dropped. This is the small-object suppression of DEVA, as used by Gaussian Grouping (Ye et
    al., ECCV 2024).
    """
    areas = masks.sum((1, 2))
    winner = np.full(masks.shape[1:], -1)
    for mask in np.lexsort((-np.arange(len(masks)), areas)):
        winner[masks[mask]] = mask
    visible = np.bincount(winner[winner >= 0], minlength=len(masks))
    return np.flatnonzero((areas > 0) & (visible >= share * areas))
