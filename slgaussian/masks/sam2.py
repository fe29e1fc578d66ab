"""The proposer ``sam2``: SAM 2 on images (Ravi et al., ICLR 2025) of ``transformers``."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from slgaussian.components.pretrained import Family
from slgaussian.masks.configs import Sam2Config
from slgaussian.masks.prompted import AutomaticProposer

if TYPE_CHECKING:
    from slgaussian.masks.sam_image import Sam2Image


class Sam2(AutomaticProposer, Sam2Config):
    """Masks by SAM 2; folders and hub names like ``facebook/sam2.1-hiera-tiny`` or ``-large``.

    Models for video can be used too; only their image part is loaded. Settings and errors are those
    of :class:`slgaussian.masks.prompted.AutomaticProposer`.
    """

    FAMILY: ClassVar[Family] = Family(
        "sam2", "Sam2Model", ("sam2", "sam2_video"), "facebook/sam2.1-hiera-tiny"
    )

    def encode(self, image: np.ndarray) -> Sam2Image:
        """Encode an image uint8 [H, W, 3], resized to the network's square input."""
        from slgaussian.masks.sam_image import Sam2Image, encoder_precision, normalised

        side, device = self.network.config.prompt_encoder_config.image_size, self.network.device
        used = side, side
        with encoder_precision(device):
            levels = self.network.get_image_embeddings(normalised(image, used).to(device))
        return Sam2Image(self.network, [e.float() for e in levels], image.shape[:2], used)
