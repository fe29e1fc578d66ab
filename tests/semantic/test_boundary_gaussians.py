"""The fringe of a thing: what of it stays along its outline, and nothing else."""

import numpy as np

from slgaussian.scene import Camera
from slgaussian.semantic.boundary_gaussians import boundary_gaussians

H, W, NEAR, FAR = 120, 160, 2.0, 4.0
CAMERA = Camera(np.array([[70.0, 0, W / 2], [0, 70, H / 2], [0, 0, 1]]), np.eye(4), W, H)


def scene(floor: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres a pixel, depth and mask of a square before a wall; on a floor as near as itself."""
    depth = np.full((H, W), FAR)
    mask = np.zeros((H, W), bool)
    mask[40:80, 50:110] = True
    depth[mask] = NEAR
    if floor:
        depth[80:] = NEAR
    return CAMERA.unproject(depth).reshape(-1, 3), depth.astype(np.float32), mask


def edge(mask: np.ndarray, by: int) -> np.ndarray:
    """The square grown by some pixels, without itself."""
    grown = np.zeros_like(mask)
    grown[40 - by : 80 + by, 50 - by : 110 + by] = True
    return grown & ~mask


def test_a_line_of_the_thing_along_its_outline_is_found_and_nothing_else():
    means, depth, mask = scene()
    line = edge(mask, 2)
    left = CAMERA.unproject(np.where(line, NEAR, depth)).reshape(-1, 3)
    found = boundary_gaussians(left, mask.ravel(), [CAMERA], [depth], [mask])
    np.testing.assert_array_equal(found.reshape(H, W), line)
    assert not boundary_gaussians(means, mask.ravel(), [CAMERA], [depth], [mask]).any()


def test_what_a_thing_stands_on_stays():
    means, depth, mask = scene(floor=True)
    found = boundary_gaussians(means, mask.ravel(), [CAMERA], [depth], [mask]).reshape(H, W)
    # At the corners wall and floor are both around.
    assert not found[83:].any() and not found[80:, 66:94].any()
    assert found.sum() < 80 < edge(mask, 3).sum() / 5
