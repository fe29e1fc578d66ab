"""Photographs square to a wall of noise, with exact pixels and depths."""

from collections.abc import Sequence

import cv2
import numpy as np

from slgaussian.scene import Camera, Sample, View

FAR = 8.0
"""Depth of the wall, of which a view shows 3 units by 1."""

HEIGHT, WIDTH, FOCAL = 80, 240, 640.0


def views_of_wall(positions: Sequence[tuple[float, float]]) -> Sample:
    """Make low, wide views from positions (x, y), which alone determine their overlap."""
    noise = np.random.default_rng(0).uniform(0, 255, (240, 2400, 3))
    wall = cv2.GaussianBlur(noise, (0, 0), 1.5)
    wall = ((wall - wall.mean()) * 4 + 128).clip(0, 255).astype(np.uint8)
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    views = []
    for number, (x, y) in enumerate(positions):
        pose = np.eye(4)
        pose[:2, 3] = x, y
        left, top = (round(step * FOCAL / FAR) for step in (x, y))
        image = np.ascontiguousarray(wall[top : top + HEIGHT, left : left + WIDTH])
        views.append(View(str(number), Camera(K, pose, WIDTH, HEIGHT), image))
    return Sample("wall", tuple(views), ())


def two_rows() -> Sample:
    """Make six views in two rows: neighbours in a row overlap by half.

    The nearest view to each is in the other row, and does not overlap with it.
    """
    return views_of_wall([(1.5 * (k // 2), 1.05 * (k % 2)) for k in range(6)])
