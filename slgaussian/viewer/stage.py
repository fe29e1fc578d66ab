"""The scene as a browser is given it: of a size that keeps its digits, and where one stands in it.

Axes are OpenCV's on both sides (x right, y down, z forward), quaternions are wxyz.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from slgaussian.gaussians import Gaussians
from slgaussian.scene import Camera

DEPTH = 10.0
"""Median depth of a scene in the units of the browser. Covariances travel as float16, whose steps
are 6e-8 there: a thousandth of the square of a pixel's width at that depth. And the keys move a
viewer by 2 units a second."""

MOST_PIXELS = 1280
"""Longer side of a picture that is drawn for a browser."""


@dataclass(frozen=True, eq=False)
class Stand:
    """Where somebody stands in the browser's scene, and how he looks.

    Attributes
    ----------
    wxyz : float64 [4]
        Rotation camera-to-world.
    position : float64 [3]
        In the browser's units.
    fov : float
        Vertical field of view, radians.
    """

    wxyz: np.ndarray
    position: np.ndarray
    fov: float


@dataclass(frozen=True, eq=False)
class Stage:
    """How the scene and the browser's copy of it belong together.

    Attributes
    ----------
    scale : float
        Units of the browser in one of the scene.
    up : float64 [3]
        Unit vector upwards.
    first : Camera
        From where the scene is seen at first.
    """

    scale: float
    up: np.ndarray
    first: Camera

    @staticmethod
    def of(gaussians: Gaussians, cameras: Mapping[str, Camera]) -> Stage:
        """The stage of a scene; without cameras it is looked at from before its middle."""
        means = gaussians.means.numpy().astype(np.float64)
        if not cameras:
            first = _before(means)
            middle = np.median(means, axis=0)
            depth = float(np.linalg.norm(first.center - middle))
            return Stage(DEPTH / depth, -first.c2w[:3, 1], first)
        first = next(iter(cameras.values()))
        depths = [camera.project(means[:: max(1, len(means) // 10_000)])[1] for camera in
                  cameras.values()]  # fmt: skip
        seen = np.concatenate([depth[depth > 0] for depth in depths])
        depth = float(np.median(seen)) if len(seen) else 1.0
        up = -np.mean([camera.c2w[:3, 1] for camera in cameras.values()], axis=0)
        length = float(np.linalg.norm(up))
        up = up / length if length > 0.1 else -first.c2w[:3, 1]
        return Stage(DEPTH / depth, up, first)

    def stand(self, camera: Camera, aspect: float) -> Stand:
        """Where to stand to see what ``camera`` sees, all of it, in a window of this aspect."""
        # A window's middle is where one looks; the picture's need not be.
        (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
        half_height = max(cy, camera.height - cy) / fy
        half_width = max(cx, camera.width - cx) / fx
        fov = 2 * np.arctan(max(half_height, half_width / aspect))
        x, y, z, w = Rotation.from_matrix(camera.c2w[:3, :3]).as_quat()
        return Stand(np.array([w, x, y, z]), self.scale * camera.center, float(fov))

    def camera(self, stand: Stand, width: int, height: int) -> Camera:
        """The camera of somebody who stands there, of a window of this many pixels.

        A larger window than :data:`MOST_PIXELS` gives a smaller picture of the same shape.
        """
        share = min(1.0, MOST_PIXELS / max(width, height))
        width, height = max(1, round(width * share)), max(1, round(height * share))
        focal = height / 2 / np.tan(stand.fov / 2)
        w, x, y, z = stand.wxyz
        c2w = np.eye(4)
        c2w[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix()
        c2w[:3, 3] = np.asarray(stand.position) / self.scale
        K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        return Camera(K, c2w, width, height)


def _before(means: np.ndarray) -> Camera:
    """A camera that sees most of the points [N, 3], along z as files of this kind mostly lie."""
    middle = np.median(means, axis=0)
    reach = float(np.quantile(np.linalg.norm(means - middle, axis=1), 0.75)) or 1.0
    c2w = np.eye(4)
    c2w[:3, 3] = middle - [0, 0, 2 * reach]
    return Camera(np.array([[600, 0, 400], [0, 600, 300], [0, 0, 1.0]]), c2w, 800, 600)
