"""Proposers out of a pretrained model that answers prompts: what is asked of it, and what is kept.

How it is asked is in :mod:`slgaussian.masks.automatic`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from slgaussian.errors import InputError
from slgaussian.kernels.threads import inside
from slgaussian.masks import Proposals
from slgaussian.parts.pretrained import Family, chosen_device, load_pretrained, model_digest
from slgaussian.parts.settings import check_settings, setting

if TYPE_CHECKING:
    from slgaussian.geometry import SeenView
    from slgaussian.masks.automatic import PromptedImage

LEVELS = ("s", "m", "l")
"""The masks that one point gives, in the order of the model's outputs: part, object, group."""


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

    def propose(self, seen: SeenView, where: np.ndarray | None = None) -> Proposals:
        """Propose masks for a view; see :class:`slgaussian.masks.MaskProposer`.

        Only grid points in ``where`` are asked; their masks may reach beyond it. Depth is not
        looked at. Scores are predicted IoU times stability.

        Raises
        ------
        InputError
            If ``where`` has the wrong type or size.
        """
        image = seen.image
        if where is not None and (where.dtype != bool or where.shape != image.shape[:2]):
            raise InputError(
                f"propose where: found {where.dtype} {where.shape}, expected bool {image.shape[:2]}"
            )
        settings = self.preset if isinstance(self.preset, Automatic) else PRESETS[self.preset]
        if self.points is not None:
            settings = replace(settings, points=self.points)
        levels = LEVELS if self.level == "all" else (self.level,)

        import torch

        from slgaussian.masks.automatic import all_masks

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


def _content(image: np.ndarray) -> tuple[tuple[int, ...], bytes]:
    return image.shape, image.tobytes()
