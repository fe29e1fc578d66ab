"""A textured plane seen by any pinhole camera: every pixel and depth is known exactly."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from slgaussian.cameras.relative import Relative
from slgaussian.predict.view_graph import Link
from slgaussian.scene import Camera, Sample, View

NORMAL = np.array([0.15, -0.1, 1.0])
"""The plane ``NORMAL . X = DISTANCE``: slanted, about 3 units in front of the origin."""
DISTANCE = 3.0


@dataclass(frozen=True)
class Plane:
    """A plane ``normal . X = distance`` with a seeded noise texture of ``cell`` units a cell."""

    normal: np.ndarray
    distance: float
    cell: float = 0.012
    seed: int = 0

    def depth(self, camera: Camera) -> np.ndarray:
        rays = camera.rays()
        return (self.distance - self.normal @ camera.center) / (rays @ self.normal)

    def view(self, name: str, camera: Camera) -> View:
        rng = np.random.default_rng(self.seed)
        # Several octaves, so that there is texture at any window size.
        noise = rng.standard_normal((512, 512, 3))
        texture = sum(s * gaussian_filter(noise, (s, s, 0), mode="wrap") for s in (1, 2, 5))
        texture = 128 + 38 * texture / texture.std()
        points = camera.unproject(self.depth(camera))
        at = np.stack([points[..., 1], points[..., 0]]) / self.cell + 256
        channels = [map_coordinates(texture[..., c], at, order=3, mode="wrap") for c in range(3)]
        image = np.stack(channels, -1).round().clip(0, 255).astype(np.uint8)
        return View(name, camera, image, self.depth(camera).astype(np.float32))


def camera(
    x: float = 0.0,
    y: float = 0.0,
    z: float = 0.0,
    turn: float = 0.0,
    size: tuple[int, int] = (120, 160),
    focal: float = 150.0,
    principal: tuple[float, float] | None = None,
    **settings: float,
) -> Camera:
    """A camera at (x, y, z), turned ``turn`` radians about its y axis; ``size`` is (H, W)."""
    H, W = size
    cx, cy = principal or (W / 2, H / 2)
    K = np.array([[focal, 0, cx], [0, focal * 1.02, cy], [0, 0, 1]])
    c2w = np.eye(4)
    c2w[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    c2w[:3, 3] = x, y, z
    return Camera(K, c2w, W, H, **settings)


def make_links(*cameras: Camera, reach: int = 9) -> list[list[Link]]:
    """Every view linked with the others up to ``reach`` before and after it."""
    return [
        [
            Link(j, Relative.between(first, second), np.zeros(0))
            for j, second in enumerate(cameras)
            if 0 < abs(j - i) <= reach
        ]
        for i, first in enumerate(cameras)
    ]


def sample(*cameras: Camera, plane: Plane | None = None) -> Sample:
    plane = plane or Plane(NORMAL, DISTANCE)
    return Sample("plane", tuple(plane.view(f"view{i}", c) for i, c in enumerate(cameras)))
