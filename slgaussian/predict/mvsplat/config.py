"""Configuration of an MVSplat network: its shape and the ranges of its outputs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Config:
    """The defaults are those of the published ``re10k.ckpt`` and ``acid.ckpt``.

    Attributes:
        width: Channels of the features at a quarter of the resolution.
        windows: The transformer attends within ``windows`` x ``windows`` parts of the feature map.
        candidates: Number of disparities of the cost volume.
        cost_levels, cost_attention: int, tuple of int. Levels of the U-Net over the cost volume,
            and its downsampling factors with attention.
        detail_width, detail_levels, detail_attention: int, int, tuple of int. The same for the
            U-Net at full resolution.
        near, far: Range of depths, in the units of the training scenes.
        scale_min, scale_max: Range of a Gaussian's standard deviation, in tenths of a pixel at its
            depth.
        sh_degree: Degree of the spherical harmonics that are predicted.
    """

    width: int = 128
    windows: int = 2
    candidates: int = 128
    cost_levels: int = 3
    cost_attention: tuple[int, ...] = (4,)
    detail_width: int = 32
    detail_levels: int = 5
    detail_attention: tuple[int, ...] = (16,)
    near: float = 1.0
    far: float = 100.0
    scale_min: float = 0.5
    scale_max: float = 15.0
    sh_degree: int = 4


PUBLISHED = Config()
