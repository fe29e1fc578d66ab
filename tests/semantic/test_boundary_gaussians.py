"""Detection of Gaussians along the outline of a removed object."""

import numpy as np

from slgaussian.scene import Camera
from slgaussian.semantic.boundary_gaussians import boundary_gaussians

H, W, NEAR, FAR = 120, 160, 2.0, 4.0
CAMERA = Camera(np.array([[70.0, 0, W / 2], [0, 70, H / 2], [0, 0, 1]]), np.eye(4), W, H)


def scene(floor: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return centres of pixels, depth and mask of a square before a wall, or on a floor."""
    depth = np.full((H, W), FAR)
    mask = np.zeros((H, W), bool)
    mask[40:80, 50:110] = True
    depth[mask] = NEAR
    if floor:
        depth[80:] = NEAR
    return CAMERA.unproject(depth).reshape(-1, 3), depth.astype(np.float32), mask


def edge(mask: np.ndarray, width: int) -> np.ndarray:
    """Return a band of pixels around the square."""
    grown = np.zeros_like(mask)
    grown[40 - width : 80 + width, 50 - width : 110 + width] = True
    return grown & ~mask


def test_boundary_gaussians_finds_the_band_along_an_outline():
    means, depth, mask = scene()
    band = edge(mask, 2)
    remaining = CAMERA.unproject(np.where(band, NEAR, depth)).reshape(-1, 3)
    boundary = boundary_gaussians(remaining, mask.ravel(), [CAMERA], [depth], [mask])
    np.testing.assert_array_equal(boundary.reshape(H, W), band)
    assert not boundary_gaussians(means, mask.ravel(), [CAMERA], [depth], [mask]).any()


def test_boundary_gaussians_ignores_a_supporting_floor():
    means, depth, mask = scene(floor=True)
    boundary = boundary_gaussians(means, mask.ravel(), [CAMERA], [depth], [mask]).reshape(H, W)
    # At the corners, wall and floor are both near.
    assert not boundary[83:].any() and not boundary[80:, 66:94].any()
    assert boundary.sum() < 80 < edge(mask, 3).sum() / 5
