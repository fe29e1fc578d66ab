"""The overlap of two views, written out."""

import numpy as np

from slgaussian.scene import Camera


def shared_view(a: Camera, b: Camera, depth: float | np.ndarray) -> float:
    """The fraction of image ``a`` that projects into ``b`` from ``depth``, a number or [9, 9]."""
    n = 9
    u, v = np.meshgrid((np.arange(n) + 0.5) / n * a.width, (np.arange(n) + 0.5) / n * a.height)
    local = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(a.K).T
    points = a.center + (local * np.broadcast_to(depth, u.shape)[..., None]) @ a.c2w[:3, :3].T
    pixels, z = b.project(points)
    return float(b.shows(pixels, z).mean())
