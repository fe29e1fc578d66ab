"""The MVSplat encoder (Chen et al., "MVSplat", ECCV 2024, arXiv:2403.14627)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import nn

from slgaussian.predict.mvsplat.backbone import Backbone
from slgaussian.predict.mvsplat.cost_volume import correlate, spread
from slgaussian.predict.mvsplat.depth import CANDIDATES, DepthPredictor, Pixelwise
from slgaussian.scene import Camera


class Network(nn.Module):
    """The encoder, with parameter names of the published checkpoints without ``encoder.``."""

    def __init__(self) -> None:
        super().__init__()
        self.backbone = Backbone()
        self.depth_predictor = DepthPredictor()

    def forward(
        self, images: torch.Tensor, cameras: Sequence[Camera], near: float, far: float
    ) -> Pixelwise:
        """Predict disparity, opacity and raw Gaussian parameters of every pixel.

        Args:
            images: float32 [V, 3, H, W]. In [0, 1]; H and W are multiples of 16.
            cameras: V Camera. Poses in the units of ``near`` and ``far``.
            near, far: Depth range of the search.
        """
        disparities = spread(near, far, CANDIDATES).to(images.device)
        local, matched = self.backbone(images)
        with torch.autocast(images.device.type, enabled=False):
            correlation = correlate(matched, cameras, disparities).permute(0, 3, 1, 2)
        return self.depth_predictor(images, local, matched, correlation, disparities)
