"""Splat Gaussians onto an image: one public call, several backends with one meaning."""

from slgaussian.rasterize.api import BACKENDS, Render, rasterize

__all__ = ["BACKENDS", "Render", "rasterize"]
