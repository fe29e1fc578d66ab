"""The proposer ``sam``: Segment Anything (Kirillov et al., ICCV 2023) of ``transformers``."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from slgaussian.components.pretrained import Family
from slgaussian.masks.configs import SamConfig
from slgaussian.masks.prompted import AutomaticProposer

if TYPE_CHECKING:
    from slgaussian.masks.sam_image import SamImage


class Sam(AutomaticProposer, SamConfig):
    """Masks by SAM; folders and hub names like ``facebook/sam-vit-base``, ``-large``, ``-huge``.

    Settings and errors are those of :class:`slgaussian.masks.prompted.AutomaticProposer`.
    """

    FAMILY: ClassVar[Family] = Family("sam", "SamModel", ("sam",), "facebook/sam-vit-base")

    def encode(self, image: np.ndarray) -> SamImage:
        """Encode an image uint8 [H, W, 3], resized to the network's longest side."""
        from slgaussian.masks.sam_image import SamImage, encoder_precision, pixel_values

        side = self.network.config.prompt_encoder_config.image_size
        pixels, used = pixel_values(image, side)
        with encoder_precision(self.network.device):
            embedding = self.network.get_image_embeddings(pixels.to(self.network.device))
        return SamImage(self.network, embedding.float(), image.shape[:2], used)
