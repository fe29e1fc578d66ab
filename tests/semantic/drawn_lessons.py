"""Small synthetic lessons: two views of a painted wall, and target views between them."""

import numpy as np
import torch

from slgaussian.gaussians import Gaussians
from slgaussian.scene import Camera
from slgaussian.semantic.lesson import Lesson

SIZE = (24, 32)


def camera(x: float, size=SIZE) -> Camera:
    c2w = np.eye(4)
    c2w[0, 3] = x
    K = np.array([[30.0, 0, size[1] / 2], [0, 30.0, size[0] / 2], [0, 0, 1]])
    return Camera(K, c2w, size[1], size[0])


def paint(points: np.ndarray, seed: int) -> np.ndarray:
    """Return ids 1 to 4 by quadrant; the seed shifts the borders."""
    x, y = points[..., 0] - 0.1 * (seed % 5), points[..., 1] + 0.07 * (seed % 3)
    return (1 + (x > 0) + 2 * (y > 0)).astype(np.int32)


def lesson(seed: int = 0, size=SIZE, targets: int = 2) -> Lesson:
    """Return two views, 0.4 apart, of a wall at depth 3, and target views between them."""
    wall = np.full(size, 3.0)
    cameras = [camera(x, size) for x in (-0.2, 0.2)]
    points = np.stack([c.unproject(wall) for c in cameras])
    n = points[..., 0].size
    gaussians = Gaussians(
        means=torch.from_numpy(points.reshape(-1, 3).astype(np.float32)),
        scales=torch.full((n, 3), 0.06),
        quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
        opacities=torch.full((n,), 0.8),
        sh=torch.zeros(n, 0, 3),
        source=torch.arange(n, dtype=torch.int32),
    )
    between = [camera(x, size) for x in np.linspace(-0.1, 0.1, targets)]
    visible = np.stack([paint(c.unproject(wall), seed) for c in between])
    return Lesson(f"wall {seed}", gaussians, paint(points, seed), tuple(between), visible)
