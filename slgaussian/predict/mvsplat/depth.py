"""Depth from the cost volume, and raw parameters of Gaussians from depth and image."""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import nn

from slgaussian.predict.mvsplat.backbone import WIDTH
from slgaussian.predict.mvsplat.unet import GROUPS, Gelu, UNet, conv

FACTOR = 4
"""Features are at this fraction of the image's resolution."""

CANDIDATES = 128
"""Number of disparities of the cost volume."""

DETAIL_CHANNELS = 32
"""Channels of the U-Net at full resolution."""

PARAMETERS = 2, 3, 4, 3 * 16
"""Raw channels of a Gaussian: offset, scale, rotation, and harmonics of degree 0 to 3."""

PREDICTED_HARMONICS = 25
"""Harmonics of a colour that the checkpoint predicts; no renderer evaluates the last nine."""

COMPUTED_CHANNELS = [
    *range(9),
    *(9 + PREDICTED_HARMONICS * colour + k for colour in range(3) for k in range(16)),
]
"""Channels of the checkpoint's last layer that are :data:`PARAMETERS`."""

STRIP_ROWS, HALO_ROWS = 64, 2
"""Image rows that the last layers process at a time, and rows around them that two 3x3 convolutions
read. The activations are then small enough for the allocator to reuse memory; fresh memory costs
more than many layers."""


class Pixelwise(NamedTuple):
    """Output of the network for every pixel.

    Attributes:
        disparity: float32 [V, H, W]. Inverse depth.
        opacity: float32 [V, H, W]. In (0, 1).
        raw: float [V, H, W, 57]. :data:`PARAMETERS`: offset, scale and rotation before their
            activations, and the harmonics of red, green and blue in the camera's frame.
    """

    disparity: torch.Tensor
    opacity: torch.Tensor
    raw: torch.Tensor


class DepthPredictor(nn.Module):
    """Layers after the cost volume, ``depth_predictor`` in the checkpoint."""

    def __init__(self) -> None:
        super().__init__()
        self.corr_refine_net = nn.Sequential(
            conv(CANDIDATES + WIDTH, WIDTH),
            nn.GroupNorm(GROUPS, WIDTH),
            Gelu(),
            UNet(WIDTH, levels=3, attention=(4,)),
            conv(WIDTH, CANDIDATES),
        )
        self.regressor_residual = nn.Conv2d(CANDIDATES + WIDTH, CANDIDATES, 1)
        self.depth_head_lowres = _two_layers(CANDIDATES, 2 * CANDIDATES, CANDIDATES)
        self.upsampler = nn.Sequential(
            conv(2 * WIDTH, WIDTH),
            nn.Upsample(scale_factor=FACTOR, mode="bilinear", align_corners=True),
            Gelu(),
        )
        self.proj_feature = conv(WIDTH, DETAIL_CHANNELS)
        self.refine_unet = nn.Sequential(
            conv(DETAIL_CHANNELS + 5, DETAIL_CHANNELS),
            nn.GroupNorm(4, DETAIL_CHANNELS),
            Gelu(),
            UNet(DETAIL_CHANNELS, levels=5, attention=(16,)),
        )
        raw = 9 + 3 * PREDICTED_HARMONICS
        self.to_gaussians = _two_layers(DETAIL_CHANNELS + 3 + WIDTH, 2 * raw, raw)
        self.to_disparity = _two_layers(DETAIL_CHANNELS, 2 * DETAIL_CHANNELS, 2)

    def forward(
        self,
        images: torch.Tensor,
        local: torch.Tensor,
        matched: torch.Tensor,
        correlation: torch.Tensor,
        disparities: torch.Tensor,
    ) -> Pixelwise:
        """Refine the depth of the cost volume and predict raw parameters.

        Args:
            images: float [V, 3, H, W]. In [0, 1].
            local, matched: float [V, C, H/4, W/4]. Features of the backbone.
            correlation: float32 [V, D, H/4, W/4]
            disparities: float32 [D]. Of the candidates, ascending.
        """
        coarse, certainty = self._coarse(matched, correlation, disparities)
        features = self.upsampler(torch.cat([matched.to(local.dtype), local], 1))
        images = images.to(features.dtype)
        hints = torch.cat([coarse, certainty], 1).to(features.dtype)
        detail = self.refine_unet(torch.cat([images, self.proj_feature(features), hints], 1))
        strips = []
        for top in range(0, images.shape[2], STRIP_ROWS):
            first = max(top - HALO_ROWS, 0)
            inputs = [
                x[:, :, first : top + STRIP_ROWS + HALO_ROWS] for x in (detail, images, features)
            ]
            heads = self._heads(inputs[0], torch.cat(inputs, 1))
            strips.append([head[:, top - first :][:, :STRIP_ROWS] for head in heads])
        depth, raw = (torch.cat(parts, 1) for parts in zip(*strips, strict=True))
        disparity = (coarse[:, 0] + depth[..., 0]).clamp(disparities[0], disparities[-1])
        return Pixelwise(disparity, depth[..., 1].sigmoid(), raw)

    def _heads(self, detail: torch.Tensor, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return change of disparity and logit of opacity, [V, h, W, 2], and raw [V, h, W, 57]."""
        # Depth in float32, whatever the precision of other layers.
        with torch.autocast(detail.device.type, enabled=False):
            depth = self.to_disparity(detail.float())
        first, activation, last = self.to_gaussians
        assert isinstance(last, nn.Conv2d) and last.bias is not None
        # Zeros up to a multiple of 16: the convolution is twice as fast with whole vectors.
        padding = -len(COMPUTED_CHANNELS) % 16
        weight = F.pad(last.weight[COMPUTED_CHANNELS], (0, 0, 0, 0, 0, 0, 0, padding))
        raw = F.conv2d(
            activation(first(x)),
            weight,
            F.pad(last.bias[COMPUTED_CHANNELS], (0, padding)),
            padding=1,
        )
        return depth.permute(0, 2, 3, 1), raw.permute(0, 2, 3, 1)[..., : len(COMPUTED_CHANNELS)]

    def _coarse(
        self, matched: torch.Tensor, correlation: torch.Tensor, disparities: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return expected disparity and greatest probability, both float32 [V, 1, H, W]."""
        volume = torch.cat([correlation, matched.to(correlation.dtype)], 1)
        refined = self.corr_refine_net(volume) + self.regressor_residual(volume)
        chances = self.depth_head_lowres(refined).float().softmax(1)
        disparity = (chances * disparities[:, None, None]).sum(1, keepdim=True)
        disparity = F.interpolate(
            disparity, scale_factor=FACTOR, mode="bilinear", align_corners=True
        )
        certainty = chances.amax(1, keepdim=True)
        return disparity, F.interpolate(certainty, scale_factor=FACTOR, mode="nearest")


def _two_layers(inputs: int, inner: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(conv(inputs, inner), Gelu(), conv(inner, outputs))
