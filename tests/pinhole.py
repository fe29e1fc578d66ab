"""Small cameras, by what a test varies."""

from collections.abc import Sequence

import numpy as np

from slgaussian.scene import Camera


def camera(
    width: int = 32,
    height: int = 24,
    focal: float = 30.0,
    cx: float | None = None,
    cy: float | None = None,
    skew: float = 0.0,
    aspect: float = 1.0,
    c2w: np.ndarray | None = None,
    place: Sequence[float] = (0.0, 0.0, 0.0),
) -> Camera:
    """A camera at ``place`` that looks along z, or at ``c2w``; ``aspect`` is a pixel's height."""
    cx, cy = width / 2 if cx is None else cx, height / 2 if cy is None else cy
    K = np.array([[focal, skew, cx], [0, focal * aspect, cy], [0, 0, 1]])
    if c2w is None:
        c2w = np.eye(4)
        c2w[:3, 3] = place
    return Camera(K, c2w, width, height)
