"""All masks of an image from a model that answers prompts: a grid of points, then a sieve.

The steps are those of Kirillov et al., "Segment Anything", ICCV 2023, section 5 and appendix B, and
the numbers of :data:`PRESETS` those of four programs that use them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import product
from pathlib import Path
from typing import Any, ClassVar, Protocol

import cv2
import numpy as np
import torch

from slgaussian.errors import InputError
from slgaussian.kernels.threads import inside
from slgaussian.masks import Proposals
from slgaussian.masks.nms import box_nms, mask_boxes, mask_nms, mostly_visible
from slgaussian.masks.regions import check_image
from slgaussian.parts.pretrained import Family, chosen_device, load_pretrained, model_digest
from slgaussian.parts.settings import check_settings, setting

LEVELS = ("s", "m", "l")
"""The masks that one point gives, in the order of the model's outputs: part, object, group."""

OVERLAP = 512 / 1500
"""Of neighbouring crops of the first layer, as a share of the image's short side."""

EDGE = 20
"""Pixels from the edge of a crop within which a mask is taken for cut off by it."""

OFFSET = 1.0
"""A stable mask hardly changes when its logits are cut that much above and below 0."""

BLOCK = 1 << 27
"""Bytes of logits at the image's size that are looked at together, or at least one mask."""

MOST = 32
"""Masks that are looked at together at most, since on the way they may be larger."""


@dataclass(frozen=True)
class Automatic:
    """What is asked and what is kept. The defaults are those of the SAM authors' program.

    Attributes
    ----------
    points : int
        Prompted points along each side of the image.
    crops : int
        Layers of crops that are prompted as images of their own: the first has 2 x 2 crops, the
        next 4 x 4, with as many points each.
    predicted_iou, stability : float
        A mask needs more than the first, by the model's own word, and at least the second: the IoU
        of its logits cut at +1 and -1.
    box_iou : float
        Of two masks whose boxes overlap more, that of the lower predicted IoU goes.
    smallest : int
        Holes and islands of fewer pixels are filled and removed.
    apart : bool
        Masks of one level are only compared with each other.
    score : float
        A mask needs at least this predicted IoU times stability.
    mask_iou, nested : float or None
        Bounds of :func:`slgaussian.masks.nms.mask_nms`; without the first, it is left out.
    visible : float or None
        Bound of :func:`slgaussian.masks.nms.mostly_visible`.
    """

    points: int = 32
    crops: int = 0
    predicted_iou: float = 0.88
    stability: float = 0.95
    box_iou: float = 0.7
    smallest: int = 0
    apart: bool = False
    score: float = 0.0
    mask_iou: float | None = None
    nested: float | None = None
    visible: float | None = None


PRESETS = {
    "sam": Automatic(),
    "sam2": Automatic(predicted_iou=0.8),
    "langsplat": Automatic(
        crops=1,
        predicted_iou=0.7,
        stability=0.85,
        smallest=100,
        apart=True,
        score=0.7,
        mask_iou=0.8,
        nested=0.5,
    ),
    "grouping": Automatic(points=64, predicted_iou=0.7, visible=0.8),
}
"""By name: the programs of SAM and SAM 2; LangSplat; Gaussian Grouping, and so the paper. What a
program is not known to change is SAM's."""


class PromptedImage(Protocol):
    """An image that a model has encoded and can be asked about, as often as wanted."""

    def segment(self, points: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits float32 [P, L, h, w] of the masks at each point, and their predicted IoU [P, L].

        ``points`` float64 [P, 2] are x and y in pixels of the image.
        """

    def enlarge(self, logits: torch.Tensor) -> torch.Tensor:
        """Logits [M, h, w] at the size of the image, float32 [M, H, W]."""


@dataclass(frozen=True, eq=False)
class AutomaticProposer(ABC):
    """A mask proposer out of a pretrained model that answers points.

    An image is encoded once (with crops, each crop too), also if it is proposed for again next with
    another ``where``; points are asked in batches. The same input gives the same bytes on the same
    machine.

    Attributes
    ----------
    model : path or str
        Folder, or name on the Hugging Face hub. Has no default.
    preset : str or Automatic
        One of :data:`PRESETS` by its name, or settings of your own.
    points : int or None
        Points along each side in place of the preset's: time goes with their square.
    level : "s", "m", "l" or "all"
        Which of the three masks of a point are looked at: part, object, group.
    batch : int
        Points asked together: 30 to 40 MiB each. Fewer are slower, by half if it is 4.
    device : str
        "auto" is "cuda" where there is one, else "cpu". On a CPU all is float32; elsewhere the
        image encoder runs in bfloat16, while prompts and masks stay float32.

    Raises
    ------
    InputError
        If a setting is out of range, or the model cannot be loaded
        (:func:`slgaussian.parts.pretrained.load_pretrained`).
    """

    FAMILY: ClassVar[Family]

    model: str | Path | None = setting(
        None, "Pretrained model: folder, or name on the Hugging Face hub.", content=model_digest
    )
    preset: str | Automatic = setting(
        "grouping",
        "Which masks are asked and kept: sam, sam2, langsplat or grouping.",
        choices=tuple(PRESETS),
    )
    points: int | None = setting(
        None, "Points prompted along each side, if not as many as the preset says.", low=1
    )
    level: str = setting(
        "all",
        "Which masks of a point: s (parts), m (objects), l (groups) or all.",
        choices=(*LEVELS, "all"),
        expected="s, m, l or all",
    )
    batch: int = setting(16, "Points prompted together: memory goes with it.", low=1)
    device: str = "auto"
    network: Any = field(init=False, repr=False)
    _encoded: dict[Any, PromptedImage] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        check_settings(self, self.FAMILY.part)
        object.__setattr__(self, "device", chosen_device(self.device))
        object.__setattr__(self, "network", load_pretrained(self.model, self.FAMILY, self.device))

    @abstractmethod
    def encode(self, image: np.ndarray) -> PromptedImage:
        """Encode an image uint8 [H, W, 3], so that points in it can be asked for."""

    def propose(
        self, image: np.ndarray, where: np.ndarray | None = None, depth: np.ndarray | None = None
    ) -> Proposals:
        """Propose masks for ``image``; see :class:`slgaussian.masks.MaskProposer`.

        Only grid points in ``where`` are asked; their masks may reach beyond it. ``depth`` is not
        looked at. Scores are predicted IoU times stability.

        Raises
        ------
        InputError
            If image or ``where`` have the wrong type or size.
        """
        check_image(image)
        if where is not None and (where.dtype != bool or where.shape != image.shape[:2]):
            raise InputError(
                f"propose where: found {where.dtype} {where.shape}, expected bool {image.shape[:2]}"
            )
        settings = self.preset if isinstance(self.preset, Automatic) else PRESETS[self.preset]
        if self.points is not None:
            settings = replace(settings, points=self.points)
        levels = LEVELS if self.level == "all" else (self.level,)
        # Left to itself, cuDNN chooses algorithms by a race, so results may differ in the last bit.
        quiet = torch.backends.cudnn.flags(benchmark=False)
        with torch.inference_mode(), quiet, inside(self.network):
            if _content(image) not in self._encoded:
                self._encoded.clear()
            return all_masks(self._encode_once, image, settings, where, levels, self.batch)

    def _encode_once(self, image: np.ndarray) -> PromptedImage:
        content = _content(image)
        if content not in self._encoded:
            self._encoded[content] = self.encode(image)
        return self._encoded[content]


def all_masks(
    encode: Callable[[np.ndarray], PromptedImage],
    image: np.ndarray,
    settings: Automatic,
    where: np.ndarray | None = None,
    levels: Sequence[str] = LEVELS,
    batch: int = 16,
) -> Proposals:
    """Masks of an image uint8 [H, W, 3] and their scores, predicted IoU times stability.

    ``encode`` makes ready an image or a crop of one; for the rest see :class:`AutomaticProposer`.
    The best score comes first.
    """
    size = image.shape[:2]
    if where is None:
        where = np.ones(size, bool)
    wanted = [LEVELS.index(level) for level in levels]
    found = []
    for crop in crop_boxes(*size, settings.crops):
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
    return ((to_crop <= EDGE) & (to_image > EDGE)).any(1)


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
    if settings.mask_iou is not None:
        kept = _by_level(
            candidates.level,
            settings.apart,
            lambda rows: mask_nms(masks[rows], scores[rows], settings.mask_iou, settings.nested),
        )
        candidates, masks, scores = candidates[kept], masks[kept], scores[kept]
    if settings.visible is not None:
        kept = mostly_visible(masks, settings.visible)
        candidates, masks, scores = candidates[kept], masks[kept], scores[kept]
    best = np.argsort(-scores, kind="stable")
    levels = candidates.level[best].astype(np.uint8)
    return Proposals(masks[best], scores[best].astype(np.float32), levels)


def _content(image: np.ndarray) -> tuple[tuple[int, ...], bytes]:
    return image.shape, image.tobytes()


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
