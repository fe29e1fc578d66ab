"""Splat Gaussians onto an image: one public call, several backends with one meaning."""

from slgaussian.rasterize.api import BACKENDS, Render, rasterize
from slgaussian.rasterize.settings import PRESETS, Settings

__all__ = ["BACKENDS", "PRESETS", "Render", "Settings", "rasterize"]
