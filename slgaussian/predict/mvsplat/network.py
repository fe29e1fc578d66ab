"""The MVSplat encoder (Chen et al., "MVSplat", ECCV 2024, arXiv:2403.14627)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import nn

from slgaussian.predict.mvsplat.backbone import Backbone
from slgaussian.predict.mvsplat.config import PUBLISHED, Config
from slgaussian.predict.mvsplat.cost_volume import correlate, spread
from slgaussian.predict.mvsplat.depth import DepthPredictor, Pixelwise
from slgaussian.rasterize.harmonics import MAX_DEGREE
from slgaussian.scene import Camera


class Network(nn.Module):
    """The encoder, with parameter names of the published checkpoints without ``encoder.``."""

    def __init__(self, config: Config = PUBLISHED) -> None:
        super().__init__()
        self.config = config
        self.backbone = Backbone(config)
        self.depth_predictor = DepthPredictor(config, (MAX_DEGREE + 1) ** 2)

    def forward(
        self,
        images: torch.Tensor,
        cameras: Sequence[Camera],
        near: float,
        far: float,
        candidates: int | None = None,
    ) -> Pixelwise:
        """Predict disparity, opacity and raw Gaussian parameters of every pixel.

        Parameters
        ----------
        images : float32 [V, 3, H, W]
            In [0, 1]; H and W are multiples of 16.
        cameras : V Camera
            Poses in the units of ``near`` and ``far``.
        near, far : float
            Depth range of the search.
        candidates : int, optional
            Number of evenly spaced disparities to correlate at, interpolated linearly to those of
            training; all of them by default.
        """
        trained = self.config.candidates
        disparities = spread(near, far, trained).to(images.device)
        local, matched = self.backbone(images)
        searched = spread(near, far, candidates or trained).to(images.device)
        with torch.autocast(images.device.type, enabled=False):
            correlation = interpolate(correlate(matched, cameras, searched), trained)
        return self.depth_predictor(images, local, matched, correlation, disparities)


def interpolate(correlation: torch.Tensor, count: int) -> torch.Tensor:
    """Resample [V, h, w, D] linearly along the disparities to [V, count, h, w]."""
    views, h, w, depths = correlation.shape
    lines = correlation.view(views, h * w, depths)
    if depths != count:
        lines = F.interpolate(lines, size=count, mode="linear", align_corners=True)
    return lines.view(views, h, w, count).permute(0, 3, 1, 2)
