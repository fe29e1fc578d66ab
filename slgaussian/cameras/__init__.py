"""Cameras: whether given ones fit their photographs, and viewpoints between and around them."""

from slgaussian.cameras.paths import between, orbit

__all__ = ["between", "orbit"]
