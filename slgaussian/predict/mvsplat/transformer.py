"""Attention within a view and between views, in shifted windows.

After GMFlow (Xu et al., CVPR 2022) and the Swin transformer (Liu et al., ICCV 2021). In a shifted
block Swin rolls the map by half a window, and adds -100 to the score of two tokens that share a
window only because the map wraps around. A weight of e^-100 is zero in float32. So here each
contiguous part of a window attends to itself alone: the same result without masks, and 9/16 of the
products.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import nn

from slgaussian.predict.mvsplat.unet import Gelu

BLOCKS = 6
TEMPERATURE = 10_000.0

Part = tuple[torch.Tensor, torch.Tensor]


class Attention(nn.Module):
    """Single-head attention with a residual connection, with or without a feed-forward net.

    Names are those of the checkpoint: ``norm1`` follows ``merge``, ``norm2`` follows ``mlp``.
    """

    def __init__(self, width: int, feed_forward: bool) -> None:
        super().__init__()
        self.q_proj = nn.Linear(width, width, bias=False)
        self.k_proj = nn.Linear(width, width, bias=False)
        self.v_proj = nn.Linear(width, width, bias=False)
        self.merge = nn.Linear(width, width, bias=False)
        self.norm1 = nn.LayerNorm(width)
        self.mlp = None
        if feed_forward:
            widen = nn.Linear(2 * width, 8 * width, bias=False)
            narrow = nn.Linear(8 * width, width, bias=False)
            self.mlp = nn.Sequential(widen, Gelu(), narrow)
            self.norm2 = nn.LayerNorm(width)

    def forward(
        self, x: torch.Tensor, memory: torch.Tensor, attended: torch.Tensor, parts: list[Part]
    ) -> torch.Tensor:
        """Update the tokens of ``x`` by attention to those of ``memory``.

        Args:
            x, memory: float [V, h, w, C]
            attended: int64 [V, n]. Indices of the views of ``memory`` that each view attends to.
            parts: list of (tokens int64 [T], keys int64 [S]). Tokens of a view, and the tokens
                among the n h w attended ones that they attend to.
        """
        q = self.q_proj(x).flatten(1, 2)
        k, v = (proj(memory)[attended].flatten(1, 3) for proj in (self.k_proj, self.v_proj))
        message = torch.empty_like(q)
        for tokens, keys in parts:
            part = q[:, None, tokens], k[:, None, keys], v[:, None, keys]
            message[:, tokens] = F.scaled_dot_product_attention(*part)[:, 0]
        message = self.norm1(self.merge(message)).view_as(x)
        if self.mlp is not None:
            message = self.norm2(self.mlp(torch.cat([x, message], -1)))
        return x + message


class Block(nn.Module):
    """Self-attention of every view, then cross-attention to the other views' input features."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.self_attn = Attention(width, feed_forward=False)
        self.cross_attn_ffn = Attention(width, feed_forward=True)

    def forward(self, x: torch.Tensor, count: int, shifted: bool) -> torch.Tensor:
        """Update features [V, h, w, C] in ``count`` x ``count`` windows."""
        views, h, w, _ = x.shape
        itself = torch.arange(views, device=x.device)[:, None]
        other_views = [[j for j in range(views) if j != i] for i in range(views)]
        attended = torch.tensor(other_views, device=x.device)
        within = parts(h, w, count, shifted, 1, x.device)
        between = parts(h, w, count, shifted, views - 1, x.device)
        return self.cross_attn_ffn(self.self_attn(x, x, itself, within), x, attended, between)


class MultiViewTransformer(nn.Module):
    """Six blocks; every second one has its windows shifted by half a window."""

    def __init__(self, width: int, windows: int) -> None:
        super().__init__()
        self.windows = windows
        self.layers = nn.ModuleList(Block(width) for _ in range(BLOCKS))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Transform features with position encoding, float [V, h, w, C], to the same shape."""
        for index, block in enumerate(self.layers):
            x = block(x, self.windows, shifted=index % 2 == 1)
        return x


def parts(h: int, w: int, count: int, shifted: bool, maps: int, device: torch.device) -> list[Part]:
    """Return pairs of tokens of an h x w map and the keys that they attend to in ``maps`` maps.

    The published code orders the keys of several views token by token, but the mask of shifted
    windows view by view. With three or more views the two disagree, so that in shifted blocks
    some keys are omitted and others included. This function reproduces that.
    """
    sides = h // count, w // count
    shift = [side // 2 if shifted else 0 for side in sides]
    tokens = torch.arange(h * w, device=device).view(h, w)
    # Wrap-around of a token's window: 1 by rows, 2 by columns.
    wraps = torch.zeros_like(tokens)
    wraps[: shift[0]] += 1
    wraps[:, : shift[1]] += 2
    order = [-s for s in shift]
    pairs = []
    rolled = tokens.roll(order, (0, 1)).view(count, sides[0], count, sides[1]).transpose(1, 2)
    for window in rolled.reshape(count * count, -1):
        kind = wraps.flatten()[window]
        for value in kind.unique():
            places = (kind == value).nonzero()[:, 0]
            key = (places + len(window) * torch.arange(maps, device=device)[:, None]).flatten()
            keys = key % maps * (h * w) + window[key // maps]
            pairs.append((window[places], keys))
    return pairs


def position_code(height: int, width: int, channels: int, device: torch.device) -> torch.Tensor:
    """Sinusoidal position encoding, float32 [height, width, channels], of y first, then of x.

    As in DETR (Carion et al., ECCV 2020): coordinates are scaled to 2 pi, and each has half of the
    channels, with sine and cosine alternating.
    """
    half = channels // 2
    wavelengths = TEMPERATURE ** (2 * (torch.arange(half, device=device) // 2) / half)

    def code(length: int) -> torch.Tensor:
        steps = torch.arange(1, length + 1, device=device)
        angles = (steps * (2 * math.pi / (length + 1e-6)))[:, None] / wavelengths
        return torch.stack([angles[:, 0::2].sin(), angles[:, 1::2].cos()], -1).flatten(1)

    y = code(height)[:, None].expand(-1, width, -1)
    x = code(width)[None].expand(height, -1, -1)
    return torch.cat([y, x], -1)
