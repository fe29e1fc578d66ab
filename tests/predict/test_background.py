"""Continued surfaces: their origin and extent; they do not cover what the views show."""

import numpy as np
import pytest
from textured_planes import camera

from slgaussian.predict import background
from slgaussian.predict.background import continue_surfaces

# Written out, not imported: a slip in the module must show here.
BEHIND, BLOCK, MARGIN = 0.03, 4, 0.07

SIZE = (60, 90)
CAMERAS = (camera(size=SIZE), camera(x=0.3, size=SIZE))
STEP = 0.01


def scene(cameras, box):
    """Inverse depths of a wall at 4 and, if asked for, a box at 2 in the middle of each view."""
    walls = [np.full((c.height, c.width), 0.25, np.float32) for c in cameras]
    for wall in walls:
        if box:
            wall[20:40, 28:60] = 0.5
    rng = np.random.default_rng(0)
    return walls, [rng.random((*wall.shape, 3), np.float32) for wall in walls]


def shows(points, cameras, walls):
    """Tell for each point [M, 3], in a plain loop, whether a view shows it or free space there."""
    out = []
    for point in points:
        observed = False
        for c, wall in zip(cameras, walls, strict=True):
            pixel, z = c.project(point)
            if z > 0 and (pixel >= 0).all() and (pixel < (c.width, c.height)).all():
                depth = 1 / wall[int(pixel[1]), int(pixel[0])]
                observed |= bool(z < depth * (1 + BEHIND) * (1 - 1e-5))
        out.append(observed)
    return np.array(out)


@pytest.mark.parametrize("box", [False, True])
@pytest.mark.parametrize("size", [SIZE, (90, 60), (61, 93), (7, 3)])
def test_only_what_no_view_shows_is_continued(box, size):
    cameras = camera(size=size), camera(x=0.3, size=size)
    walls, colors = scene(cameras, box)
    splats = continue_surfaces(cameras, colors, walls, [STEP] * 2)
    splats.check()
    assert len(splats) > 0
    points = splats.means.numpy().astype(np.float64)
    view = splats.source.numpy() // (size[0] * size[1])
    for i in range(2):
        # Float32 means: a point just inside a border may be just outside. Measured none.
        rest = [[v[1 - i]] for v in (cameras, walls)]
        assert not shows(points[view == i], *rest).any()


def test_a_view_goes_on_beyond_its_border():
    walls, colors = scene(CAMERAS[:1], False)
    splats = continue_surfaces(CAMERAS[:1], colors, walls, [STEP])
    pixels, z = CAMERAS[0].project(splats.means.numpy().astype(np.float64))
    assert np.allclose(z, 4, rtol=1e-5)
    width = 0.5 * BLOCK * 4 / np.sqrt(CAMERAS[0].K[0, 0] * CAMERAS[0].K[1, 1])
    assert np.allclose(splats.scales.numpy(), [width, width, 0.1 * width], rtol=1e-5)
    H, W = SIZE
    outside = (pixels < 0).any(1) | (pixels > (W, H)).any(1)
    assert outside.all()
    reach = MARGIN * W
    assert (pixels.min(0) < -reach + BLOCK).all()
    assert (pixels.max(0) > np.array([W, H]) + reach - BLOCK).all()
    row, column = np.divmod(splats.source.numpy(), W)
    assert np.allclose(splats.colours().numpy(), colors[0][row, column], atol=1e-6)
    # The pixel nearest to each.
    nearest = np.floor(pixels + 1e-3).clip(0, (W - 1, H - 1))
    assert np.array_equal(np.stack([column, row], 1), nearest)


@pytest.mark.parametrize(
    ("most", "step", "reach"), [(1, STEP, 1), (2, STEP, 2), (12, STEP, 3), (12, 0.035, 2)]
)
def test_the_wall_goes_on_behind_a_box_as_far_as_parallax_shows_it(most, step, reach, monkeypatch):
    monkeypatch.setattr(background, "MAX_BLOCKS", most)
    walls, colors = scene(CAMERAS[:1], True)
    splats = continue_surfaces(CAMERAS[:1], colors, walls, [step])
    pixels, z = CAMERAS[0].project(splats.means.numpy().astype(np.float64))
    column, row = np.floor(pixels).astype(int).T
    behind = (column >= 28) & (column < 60) & (row >= 20) & (row < 40)
    # The outermost of the 5 x 8 blocks that the box covers.
    assert behind.sum() == 5 * 8 - max(5 - 2 * reach, 0) * max(8 - 2 * reach, 0)
    assert np.allclose(z[behind], 4, rtol=1e-5)
    K = CAMERAS[0].K
    width = 0.5 * BLOCK * 4 / np.sqrt(K[0, 0] * K[1, 1])
    assert np.allclose(splats.scales.numpy()[behind, :2], width, rtol=1e-5)
    inner = (column >= 40) & (column < 50) & (row >= 28) & (row < 32)
    assert inner.any() == (reach > 2)
