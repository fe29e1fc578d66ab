"""Base class of proposers that prompt a pretrained model.

The algorithm is in :mod:`slgaussian.masks.automatic`.
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
    """A mask proposer that prompts a pretrained model with points.

    An image is encoded once, even if the next call has the same image with another ``region``.
    Points are prompted in batches. The same input gives the same bytes on the same machine.

    Fields are those of :class:`slgaussian.masks.configs.AutomaticConfig`. Time grows with the
    square of ``points``. A prompted point takes 30 to 40 MiB; a batch of 4 takes half as long
    again as one of 16.

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
    _encoded: tuple[Any, PromptedImage] | None = PrivateAttr(None)

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        self._network = load_pretrained(self.model, self.FAMILY, self.device)

    @property
    def network(self) -> Any:
        """Model of ``transformers``, on its device."""
        return self._network

    @abstractmethod
    def encode(self, image: np.ndarray) -> PromptedImage:
        """Encode an image uint8 [H, W, 3] for prompts."""

    def propose(self, frame: SeenView, region: np.ndarray | None = None) -> Proposals:
        """Propose masks for a view; see :class:`slgaussian.masks.MaskProposer`.

        Only grid points in ``region`` are prompted; their masks may extend beyond it. Depth is not
        used. Scores are predicted IoU times stability.

        Raises:
            InputError: If ``region`` has the wrong type or size.
        """
        image = frame.image
        if region is not None and (region.dtype != bool or region.shape != image.shape[:2]):
            raise InputError(
                f"propose region: found {region.dtype} {region.shape}, expected bool "
                f"{image.shape[:2]}"
            )
        settings = self.preset if isinstance(self.preset, Automatic) else PRESETS[self.preset]
        if self.points is not None:
            settings = replace(settings, points=self.points)
        levels = LEVELS if self.level == "all" else (self.level,)

        with torch.inference_mode(), inside(self.network):
            return all_masks(self._encode_once, image, settings, region, levels, self.batch)

    def _encode_once(self, image: np.ndarray) -> PromptedImage:
        content = image.shape, image.tobytes()
        if self._encoded is None or self._encoded[0] != content:
            self._encoded = None
            self._encoded = content, self.encode(image)
        return self._encoded[1]
