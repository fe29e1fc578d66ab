"""Depth from the cost volume, and raw parameters of Gaussians from depth and image."""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import nn

from slgaussian.predict.mvsplat.config import Config
from slgaussian.predict.mvsplat.unet import GROUPS, Gelu, UNet, conv

FACTOR = 4
"""Features are at this fraction of the image's resolution."""

POSE_CHANNELS = 9
"""Raw channels before the harmonics: 2 of offset, 3 of scale, 4 of rotation."""

VECTOR = 16
"""Largest number of elements of a SIMD vector."""

STRIP = 64
"""Image rows that the last layers process at a time. Their activations are then small enough for
the allocator to reuse memory; fresh memory costs more than many layers."""

HALO = 2
"""Rows around a strip in the receptive field of two 3x3 convolutions."""


class Pixelwise(NamedTuple):
    """Output of the network for every pixel.

    Attributes:
        disparity: float32 [V, H, W]. Inverse depth.
        opacity: float32 [V, H, W]. In (0, 1).
        raw: float [V, H, W, 9 + 16 * 3]. Offset, scale and rotation before their activations, and
            harmonics of degree 0 to 3 in the camera's frame, three colours a coefficient.
    """

    disparity: torch.Tensor
    opacity: torch.Tensor
    raw: torch.Tensor


class DepthPredictor(nn.Module):
    """Layers after the cost volume, ``depth_predictor`` in the checkpoint.

    Only ``drawn`` of the predicted harmonics are computed: no renderer evaluates the last nine.
    """

    def __init__(self, config: Config, drawn: int) -> None:
        super().__init__()
        width, depths, detail = config.width, config.candidates, config.detail_width
        self.corr_refine_net = nn.Sequential(
            conv(depths + width, width),
            nn.GroupNorm(GROUPS, width),
            Gelu(),
            UNet(width, config.cost_levels, config.cost_attention),
            conv(width, depths),
        )
        self.regressor_residual = nn.Conv2d(depths + width, depths, 1)
        self.depth_head_lowres = nn.Sequential(
            conv(depths, 2 * depths), Gelu(), conv(2 * depths, depths)
        )
        self.upsampler = nn.Sequential(
            conv(2 * width, width),
            nn.Upsample(scale_factor=FACTOR, mode="bilinear", align_corners=True),
            Gelu(),
        )
        self.proj_feature = conv(width, detail)
        self.refine_unet = nn.Sequential(
            conv(detail + 5, detail),
            nn.GroupNorm(4, detail),
            Gelu(),
            UNet(detail, config.detail_levels, config.detail_attention),
        )
        coefficients = (config.sh_degree + 1) ** 2
        raw = POSE_CHANNELS + 3 * coefficients
        self.to_gaussians = nn.Sequential(
            conv(detail + 3 + width, 2 * raw), Gelu(), conv(2 * raw, raw)
        )
        self.to_disparity = nn.Sequential(conv(detail, 2 * detail), Gelu(), conv(2 * detail, 2))
        self.kept = computed_channels(coefficients, drawn)

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
        coarse, certainty = self.coarse(matched, correlation, disparities)
        features = self.upsampler(torch.cat([matched.to(local.dtype), local], 1))
        images = images.to(features.dtype)
        hints = torch.cat([coarse, certainty], 1).to(features.dtype)
        detail = self.refine_unet(torch.cat([images, self.proj_feature(features), hints], 1))
        return self.heads(images, features, detail, coarse[:, 0], disparities)

    def coarse(
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

    def heads(
        self,
        images: torch.Tensor,
        features: torch.Tensor,
        detail: torch.Tensor,
        coarse: torch.Tensor,
        disparities: torch.Tensor,
    ) -> Pixelwise:
        """Apply the full-resolution heads, the widest layers, in strips of rows."""
        views, _, H, W = images.shape
        disparity, opacity = (coarse.new_empty(views, H, W) for _ in range(2))
        raw = features.new_empty(views, H, W, len(self.kept))
        for view in range(views):
            for top in range(0, H, STRIP):
                rows = slice(max(top - HALO, 0), top + STRIP + HALO)
                mine = slice(top - rows.start, top - rows.start + STRIP)
                parts = [x[view : view + 1, :, rows] for x in (detail, images, features)]
                out = view, slice(top, top + STRIP)
                # Depth in float32, whatever the precision of other layers.
                with torch.autocast(detail.device.type, enabled=False):
                    delta, density = self.to_disparity(parts[0].float())[0, :, mine]
                disparity[out] = (coarse[out] + delta).clamp(disparities[0], disparities[-1])
                opacity[out] = density.sigmoid()
                raw[out] = self.raw_gaussians(torch.cat(parts, 1))[0, mine]
        return Pixelwise(disparity, opacity, raw)

    def raw_gaussians(self, x: torch.Tensor) -> torch.Tensor:
        """Convert features [1, C, H, W] to raw parameters [1, H, W, 9 + 16 * 3]."""
        first, activation, last = self.to_gaussians
        assert isinstance(last, nn.Conv2d) and last.bias is not None  # as it was made
        weight, bias = last.weight[self.kept], last.bias[self.kept]
        # Zeros up to the next multiple: the convolution is twice as fast with whole vectors.
        padding = -len(weight) % VECTOR
        weight = F.pad(weight, (0, 0, 0, 0, 0, 0, 0, padding))
        x = F.conv2d(activation(first(x)), weight, F.pad(bias, (0, padding)), padding=1)
        return x.permute(0, 2, 3, 1)[..., : len(self.kept)]


def computed_channels(coefficients: int, drawn: int) -> list[int]:
    """Return the channels of the head to compute, reordered from colour-major to
    coefficient-major."""
    harmonics = [
        POSE_CHANNELS + color * coefficients + k for k in range(drawn) for color in range(3)
    ]
    return [*range(POSE_CHANNELS), *harmonics]
