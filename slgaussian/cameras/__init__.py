"""Cameras: check them against photographs, estimate them, interpolate between them."""

from slgaussian.cameras.paths import between, orbit

__all__ = ["between", "orbit"]
