"""Cameras: whether given ones fit their photographs, and viewpoints between and around them."""

from slgaussian.cameras.trajectories import between, orbit

__all__ = ["between", "orbit"]
