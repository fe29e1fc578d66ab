"""The U-Net that refines both the cost volume and the full-resolution depth.

That of latent diffusion (Rombach et al., CVPR 2022) without time steps, of one width at all levels,
with the normalisation after the convolution, and attention across all views at once.
"""

from __future__ import annotations

from collections import OrderedDict

import torch
import torch.nn.functional as F
from torch import nn

GROUPS = 8
HEAD_WIDTH = 32


def conv(inputs: int, outputs: int, stride: int = 1) -> nn.Conv2d:
    """A 3x3 convolution that keeps the size, or halves it with ``stride`` 2."""
    return nn.Conv2d(inputs, outputs, 3, stride, padding=1)


def normalise(inputs: int, outputs: int) -> nn.Sequential:
    """Convolution, group normalisation, SiLU."""
    norm = nn.GroupNorm(GROUPS, outputs)
    return nn.Sequential(conv(inputs, outputs), norm, nn.SiLU(inplace=True))


class Gelu(nn.Module):
    """GELU in the memory of its argument, which must be an intermediate value."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Any shape."""
        return torch.ops.aten.gelu_(x)


class ResBlock(nn.Module):
    """Two convolutions beside a skip."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.in_layers = normalise(inputs, outputs)
        self.out_layers = normalise(outputs, outputs)
        self.skip_connection = nn.Identity() if inputs == outputs else nn.Conv2d(inputs, outputs, 1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """[V, inputs, H, W] to [V, outputs, H, W]."""
        return self.out_layers(self.in_layers(x)).add_(self.skip_connection(x))


class ViewAttention(nn.Module):
    """Every pixel of every view attends to every pixel of every view, in heads of 32 channels."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.qkv = nn.Conv1d(width, 3 * width, 1)
        self.proj_out = nn.Conv1d(width, width, 1)
        self.norm = nn.GroupNorm(GROUPS, width)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """[V, C, H, W] to the same."""
        views, width, h, w = x.shape
        tokens = x.permute(0, 2, 3, 1).reshape(-1, width)
        qkv = F.linear(tokens, self.qkv.weight[..., 0], self.qkv.bias)
        # Each head has its own query, key and value side by side.
        q, k, v = qkv.view(1, -1, width // HEAD_WIDTH, 3, HEAD_WIDTH).transpose(1, 2).unbind(3)
        values = F.scaled_dot_product_attention(q, k, v).transpose(1, 2).reshape(-1, width)
        values = F.linear(values, self.proj_out.weight[..., 0], self.proj_out.bias)
        return self.norm(values.view(views, h, w, width).permute(0, 3, 1, 2)) + x


class UNet(nn.Module):
    """The whole U-Net; the names of its parts are the checkpoint's.

    Args:
        width: Channels, in and out and at every level.
        attention: tuple of int. Factors of downsampling at which views attend to each other.
    """

    def __init__(self, width: int, levels: int, attention: tuple[int, ...]) -> None:
        super().__init__()

        def stage(inputs: int, level: int, *then: nn.Module) -> nn.Sequential:
            attends = [ViewAttention(width)] if 2**level in attention else []
            return nn.Sequential(ResBlock(inputs, width), *attends, *then)

        down = [nn.Sequential(conv(width, width)), stage(width, 0)]
        for level in range(1, levels):
            halve = nn.Sequential(OrderedDict(op=conv(width, width, stride=2)))
            down += [nn.Sequential(halve), stage(width, level)]
        up = []
        for level in reversed(range(levels)):
            double = nn.Sequential(
                OrderedDict(up=nn.Upsample(scale_factor=2), conv=conv(width, width))
            )
            leave = [double] if level else []
            up += [stage(2 * width, level), stage(2 * width, level, *leave)]
        self.input_blocks = nn.ModuleList(down)
        middle = ResBlock(width, width), nn.Identity(), ResBlock(width, width)
        self.middle_block = nn.Sequential(*middle)
        self.output_blocks = nn.ModuleList(up)
        self.out = normalise(width, width)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """[V, C, H, W] to the same; H and W are multiples of 2^(levels - 1)."""
        skips = []
        for block in self.input_blocks:
            x = block(x)
            skips.append(x)
        x = self.middle_block(x)
        for block in self.output_blocks:
            x = block(torch.cat([x, skips.pop()], 1))
        return self.out(x)
