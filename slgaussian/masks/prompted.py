"""Proposers out of a pretrained model that answers prompts: what is asked of it, and what is kept.

How it is asked is in :mod:`slgaussian.masks.automatic`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch
from pydantic import PrivateAttr

from slgaussian.components.pretrained import Family, load_pretrained
from slgaussian.errors import InputError
from slgaussian.kernels.threads import inside
from slgaussian.masks import Proposals
from slgaussian.masks.automatic import PromptedImage, all_masks
from slgaussian.masks.configs import LEVELS, PRESETS, Automatic, AutomaticConfig

if TYPE_CHECKING:
    from slgaussian.geometry import SeenView


class AutomaticProposer(AutomaticConfig, ABC):
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
        (:func:`slgaussian.components.pretrained.load_pretrained`).
    """

    FAMILY: ClassVar[Family]

    device: str = "auto"
    _network: Any = PrivateAttr()
    _encoded: dict[Any, PromptedImage] = PrivateAttr(default_factory=dict)

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        self._network = load_pretrained(self.model, self.FAMILY, self.device)

    @property
    def network(self) -> Any:
        """The model of ``transformers``, on its device."""
        return self._network

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
