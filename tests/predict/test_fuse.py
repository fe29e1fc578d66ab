"""Cameras that meet half way, and one colour for what two views show."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from textured_planes import camera, sample

from slgaussian.cameras.relative import Relative
from slgaussian.predict.fill import AGREES, cross_check
from slgaussian.predict.fuse import blend, meet
from slgaussian.predict.links import Link

# Written out, not imported: a slip in the module must show here.
FEATHER = 16.0

CAMERAS = (camera(turn=0.2, focal=140, principal=(70, 50)), camera(x=0.4, y=0.1, turn=-0.1))


def links_of(*cameras):
    """Every view linked with every other, with the poses of these cameras."""
    return [
        [
            Link(j, Relative.between(one, other), np.zeros(0))
            for j, other in enumerate(cameras)
            if j != i
        ]
        for i, one in enumerate(cameras)
    ]


def disturbed(given, turn, move):
    c2w = given.c2w.copy()
    c2w[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ c2w[:3, :3]
    c2w[:3, 3] += move
    return replace(given, c2w=c2w)


def turned_by(a, b):
    return np.linalg.norm(Rotation.from_matrix(b.c2w[:3, :3] @ a.c2w[:3, :3].T).as_rotvec())


def test_two_cameras_meet_half_way():
    turn, move = np.array([0.01, -0.02, 0.005]), np.array([0.02, 0.01, -0.03])
    refined = links_of(CAMERAS[0], disturbed(CAMERAS[1], turn, move))
    met = meet(CAMERAS, refined)
    # Exact for two but for rounding: 1e-16 times a few products.
    for link, (a, b) in ((refined[0][0], met), (refined[1][0], met[::-1])):
        found = Relative.between(a, b)
        assert np.allclose(found.R, link.relative.R, atol=1e-12)
        assert np.allclose(found.t, link.relative.t, atol=1e-12)
    for before, after in zip(CAMERAS, met, strict=True):
        assert turned_by(before, after) == pytest.approx(np.linalg.norm(turn) / 2, rel=1e-6)
    assert np.allclose(
        met[0].center - CAMERAS[0].center, CAMERAS[1].center - met[1].center, atol=1e-12
    )


def test_cameras_that_agree_stay():
    three = (*CAMERAS, camera(x=-0.2, y=0.3, turn=0.05))
    for before, after in zip(three, meet(three, links_of(*three)), strict=True):
        assert np.allclose(before.c2w, after.c2w, atol=1e-12)


def test_three_cameras_meet():
    three = (*CAMERAS, camera(x=-0.2, y=0.3, turn=0.05))
    rng = np.random.default_rng(0)
    moved = [disturbed(c, rng.normal(0, 0.003, 3), rng.normal(0, 0.01, 3)) for c in three]
    refined = links_of(*moved)
    met = meet(three, refined)
    for i, sources in enumerate(refined):
        for link in sources:
            found = Relative.between(met[i], met[link.source])
            # To first order: squares of 0.005 radians. The disturbance itself is 100 times that.
            assert np.abs(found.R - link.relative.R).max() < 5e-5
            assert np.abs(found.t - link.relative.t).max() < 5e-5


def plainly_blended(images, inverse_depths, steps, links):
    """The definition, pixel by pixel in float64."""
    out = []
    for i, sources in enumerate(links):
        H, W = inverse_depths[i].shape
        mixed = np.zeros((H, W, 3))
        verdicts = [
            cross_check(inverse_depths[i], inverse_depths[s.source], s.relative, steps[i])
            for s in sources
        ]
        for y in range(H):
            for x in range(W):
                u, v = x + 0.5, y + 0.5
                weight = min(1, min(u, W - u, v, H - v) / FEATHER)
                total = weight * images[i][y, x].astype(float)
                for link, verdict in zip(sources, verdicts, strict=True):
                    if verdict[y, x] != AGREES:
                        continue
                    (a, b), _ = link.relative.project(np.array([u, v]), inverse_depths[i][y, x])
                    h, w = inverse_depths[link.source].shape
                    say = min(1, min(a, w - a, b, h - b) / FEATHER)
                    left, top = int(np.floor(a - 0.5)), int(np.floor(b - 0.5))
                    seen = np.zeros(3)
                    for row, column in np.ndindex(2, 2):
                        share = 1 - abs(a - 0.5 - left - column)
                        share *= 1 - abs(b - 0.5 - top - row)
                        r, c = np.clip(top + row, 0, h - 1), np.clip(left + column, 0, w - 1)
                        seen += share * images[link.source][r, c]
                    total = total + say * seen
                    weight += say
                mixed[y, x] = total / weight
        out.append(mixed)
    return out


@pytest.mark.parametrize("views", [2, 3])
def test_a_blend_is_that_of_the_definition(views):
    """On noise, where a wrong pixel shows; half the depths of one view do not agree."""
    cameras = [camera(size=(24, 40), focal=30), camera(x=0.3, size=(24, 40), focal=33),
               camera(x=-0.2, y=0.2, size=(24, 40), focal=30)][:views]  # fmt: skip
    rng = np.random.default_rng(1)
    images = [rng.random((24, 40, 3), np.float32) for _ in cameras]
    depths = [1 / view.depth.astype(np.float32) for view in sample(*cameras).context]
    depths[1][:, ::2] *= 1.5
    links = links_of(*cameras)
    mixed = blend(images, depths, [0.001] * views, links)
    for found, expected in zip(
        mixed, plainly_blended(images, depths, [0.001] * views, links), strict=True
    ):
        assert found.dtype == np.float32
        # Weights and fractions of a pixel in float32: measured 4e-7.
        assert np.abs(found - expected).max() < 2e-6


def test_both_copies_of_a_surface_get_one_colour():
    views = sample(*CAMERAS).context
    depths = [1 / view.depth.astype(np.float32) for view in views]
    H, W = depths[0].shape
    images = [np.full((H, W, 3), level, np.float32) for level in (0.2, 0.6)]
    mixed = blend(images, depths, [0.001] * 2, links_of(*CAMERAS))
    relative = Relative.between(*CAMERAS)
    y, x = np.mgrid[30:90, 40:120]
    where, _ = relative.project(np.stack([x, y], -1) + 0.5, depths[0][y, x])
    inside = (where > 1).all(-1) & (where < (W - 1, H - 1)).all(-1)
    column, row = where[inside].astype(int).T
    # The weights are looked up at pixel centres, up to half a pixel of 16 apart.
    assert inside.mean() > 0.5
    assert np.abs(mixed[0][y, x][inside] - mixed[1][row, column]).max() < 0.4 * 0.5 / FEATHER


def test_without_overlap_colours_stay():
    apart = (camera(), camera(x=50.0))
    views = sample(camera(), camera(x=0.1)).context
    images = [(view.image / 255).astype(np.float32) for view in views]
    depths = [1 / view.depth.astype(np.float32) for view in views]
    mixed = blend(images, depths, [0.001] * 2, links_of(*apart))
    # A weight times a value over the weight: two roundings.
    assert np.allclose(mixed, images, rtol=3e-7)
