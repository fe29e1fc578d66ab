"""The proposers ``sam`` and ``sam2``: Segment Anything and SAM 2 on images, of ``transformers``.

Kirillov et al., ICCV 2023, and Ravi et al., ICLR 2025.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from PIL import Image
from torch.nn import functional as F

from slgaussian.components.pretrained import Family
from slgaussian.masks.automatic import AutomaticProposer
from slgaussian.masks.configs import Sam2Config, SamConfig

MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Mean and standard deviation of ImageNet colours in [0, 1], by which SAM models normalise."""


def pixel_values(image: np.ndarray, side: int) -> tuple[torch.Tensor, tuple[int, int]]:
    """Return the network input float32 [1, 3, side, side] of an image, and its used height, width.

    The longest side is resized to ``side``; the bottom or right is padded with 0, the mean colour.
    """
    height, width = image.shape[:2]
    scale = side / max(height, width)
    used = max(1, int(height * scale + 0.5)), max(1, int(width * scale + 0.5))
    pixels = normalise(image, used)
    return F.pad(pixels, (0, side - used[1], 0, side - used[0])), used


def normalise(image: np.ndarray, size: tuple[int, int]) -> torch.Tensor:
    """Resize an image uint8 [H, W, 3] bilinearly and normalise it, float32 [1, 3, *size]."""
    resized = Image.fromarray(image).resize(size[::-1], Image.Resampling.BILINEAR)
    pixels = torch.from_numpy(np.array(resized, np.float32)).permute(2, 0, 1)[None] / 255
    return (pixels - torch.tensor(MEAN).view(3, 1, 1)) / torch.tensor(STD).view(3, 1, 1)


def encoder_precision(device: torch.device) -> torch.autocast:
    """Return the autocast context of the image encoder: bfloat16 on accelerators, else float32."""
    return torch.autocast(device.type, torch.bfloat16, enabled=device.type != "cpu")


@dataclass(frozen=True, eq=False)
class SamImage:
    """An encoded image that can be prompted repeatedly.

    Attributes:
        network: SamModel
        embedding: float32 [1, C, h, w]
        size: (int, int). Height and width of the image.
        used: (int, int). Height and width of the image in the network's input.
    """

    network: Any
    embedding: Any
    size: tuple[int, int]
    used: tuple[int, int]

    def segment(self, points: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mask logits float32 [P, 3, h, w] at each point and their predicted IoU [P, 3].

        ``points`` float64 [P, 2] are x and y in pixels of the image; each is prompted separately,
        as foreground.
        """
        scaled = points * (self.used[1] / self.size[1], self.used[0] / self.size[0])
        prompts = torch.from_numpy(scaled.astype(np.float32)).to(self.network.device)
        output = self.network(
            image_embeddings=self.embedding,
            input_points=prompts[None, :, None],
            input_labels=torch.ones(1, len(points), 1, dtype=torch.int64, device=prompts.device),
            multimask_output=True,
        )
        return output.pred_masks[0].float(), output.iou_scores[0].float()

    def enlarge(self, logits: torch.Tensor) -> torch.Tensor:
        """Resize logits [M, h, w] to the image, float32 [M, H, W], without the input's padding."""
        side = self.network.config.prompt_encoder_config.image_size
        large = F.interpolate(logits[:, None], (side, side), mode="bilinear")
        large = large[:, :, : self.used[0], : self.used[1]]
        return F.interpolate(large, self.size, mode="bilinear")[:, 0]


class Sam2Image(SamImage):
    """An encoded image; ``embedding`` is a list of three, from fine to coarse."""

    def enlarge(self, logits: torch.Tensor) -> torch.Tensor:
        """Resize directly to the image."""
        return F.interpolate(logits[:, None], self.size, mode="bilinear")[:, 0]


class Sam(AutomaticProposer, SamConfig):
    """Masks by SAM; folders and hub names like ``facebook/sam-vit-base``, ``-large``, ``-huge``.

    Settings and errors are those of :class:`slgaussian.masks.automatic.AutomaticProposer`.
    """

    FAMILY: ClassVar[Family] = Family("sam", "SamModel", ("sam",), "facebook/sam-vit-base")

    def encode(self, image: np.ndarray) -> SamImage:
        """Encode an image uint8 [H, W, 3], resized to the network's longest side."""
        pixels, used = pixel_values(image, self.network.config.prompt_encoder_config.image_size)
        with encoder_precision(self.network.device):
            embedding = self.network.get_image_embeddings(pixels.to(self.network.device))
        return SamImage(self.network, embedding.float(), image.shape[:2], used)


class Sam2(AutomaticProposer, Sam2Config):
    """Masks by SAM 2; folders and hub names like ``facebook/sam2.1-hiera-tiny`` or ``-large``.

    Models for video can be used too; only their image part is loaded. Settings and errors are those
    of :class:`slgaussian.masks.automatic.AutomaticProposer`.
    """

    FAMILY: ClassVar[Family] = Family(
        "sam2", "Sam2Model", ("sam2", "sam2_video"), "facebook/sam2.1-hiera-tiny"
    )

    def encode(self, image: np.ndarray) -> Sam2Image:
        """Encode an image uint8 [H, W, 3], resized to the network's square input."""
        side, device = self.network.config.prompt_encoder_config.image_size, self.network.device
        used = side, side
        with encoder_precision(device):
            levels = self.network.get_image_embeddings(normalise(image, used).to(device))
        return Sam2Image(self.network, [e.float() for e in levels], image.shape[:2], used)
