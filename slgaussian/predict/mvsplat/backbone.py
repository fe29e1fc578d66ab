"""Features of every view: a small residual CNN, then attention within and between views."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import nn

from slgaussian.predict.mvsplat.transformer import MultiViewTransformer, position_code

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)

WIDTH = 128
"""Channels of the features at a quarter of the resolution."""

WINDOWS = 2
"""The transformer attends within this many parts of the feature map along each side."""


class ResidualBlock(nn.Module):
    """Two convolutions beside a skip; instance normalisation, which has no weights."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, padding=1, bias=False)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1, bias=False)
        same_shape = stride == 1 and inputs == outputs
        self.downsample = (
            None if same_shape else nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride))
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """[V, inputs, H, W] to [V, outputs, H / stride, W / stride]."""
        y = instance_norm(self.conv1(x)).relu_()
        y = instance_norm(self.conv2(y)).relu_()
        skip = x if self.downsample is None else instance_norm(self.downsample(x))
        return y.add_(skip).relu_()


class FeatureCnn(nn.Module):
    """Images to features at a quarter of the resolution (GMFlow's encoder, Xu et al. 2022)."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, 2, padding=3, bias=False)
        self.layer1 = nn.Sequential(ResidualBlock(64, 64, 1), ResidualBlock(64, 64, 1))
        self.layer2 = nn.Sequential(ResidualBlock(64, 96, 2), ResidualBlock(96, 96, 1))
        self.layer3 = nn.Sequential(ResidualBlock(96, 128, 1), ResidualBlock(128, 128, 1))
        self.conv2 = nn.Conv2d(128, WIDTH, 1)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """[V, 3, H, W] in [0, 1] to [V, WIDTH, H/4, W/4]."""
        mean = images.new_tensor(IMAGENET_MEAN)[:, None, None]
        std = images.new_tensor(IMAGENET_STD)[:, None, None]
        x = instance_norm(self.conv1((images - mean) / std)).relu_()
        return self.conv2(self.layer3(self.layer2(self.layer1(x))))


class Backbone(nn.Module):
    """The CNN and the transformer, ``backbone`` in the checkpoint."""

    def __init__(self) -> None:
        super().__init__()
        self.backbone = FeatureCnn()
        self.transformer = MultiViewTransformer(WIDTH, WINDOWS)

    def forward(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Features of V images [V, 3, H, W], H and W multiples of 16.

        Returns:
            local, matched: float [V, WIDTH, H/4, W/4]. Before positions and attention, and after.
        """
        local = self.backbone(images)
        h, w = local.shape[2:]
        code = position_code(h // WINDOWS, w // WINDOWS, WIDTH, local.device)
        positioned = local.permute(0, 2, 3, 1) + code.tile(WINDOWS, WINDOWS, 1)
        return local, self.transformer(positioned).permute(0, 3, 1, 2)


def instance_norm(x: torch.Tensor) -> torch.Tensor:
    """Every channel of every image to mean 0 and variance 1."""
    # As groups of one channel: PyTorch's own instance norm copies to another memory layout.
    return F.group_norm(x, x.shape[1])
