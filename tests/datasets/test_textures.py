"""Textures of solids: patterns without seams, pictures upright."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.datasets.procedural import textures
from slgaussian.datasets.procedural.raycast import BALL, BOX, CONE, CYLINDER, RING, normal_at
from slgaussian.datasets.procedural.textures import Material, albedo, pack


def colour(material: Material, kind: int, size: tuple[float, ...], point) -> np.ndarray:
    materials = pack([material], np.random.default_rng(0))
    size = np.array((*size, 0, 0)[:3], np.float64)
    return np.array(
        albedo(materials, 0, kind, size, tuple(point), normal_at(kind, size, tuple(point)))
    )


def on_round(kind: int, angle: float, up: float) -> tuple[tuple[float, ...], np.ndarray]:
    """Return a size, and the surface point of such a solid at a longitude and a height."""
    size, rho, z = {
        BALL: ((0.5,), math.sqrt(0.25 - (0.5 * up) ** 2), 0.5 * up),
        CYLINDER: ((0.4, 0.5), 0.4, 0.5 * up),
        CONE: ((0.4, 0.5), 0.4 * (1 - up) / 2, 0.5 * up),
        RING: ((0.5, 0.15), 0.5 + 0.15 * math.cos(up * math.pi), 0.15 * math.sin(up * math.pi)),
    }[kind]
    return size, np.array((rho * math.cos(angle), rho * math.sin(angle), z))


@given(
    kind=st.sampled_from([BALL, CYLINDER, CONE, RING]),
    pattern=st.sampled_from([textures.STRIPED, textures.CHECKED, textures.DOTTED]),
    cell=st.floats(0.04, 0.3),
    up=st.floats(-0.9, 0.9),
)
def test_patterns_close_around_round_solids_without_a_seam(kind, pattern, cell, up):
    # u is periodic with whole cells, so the seam at longitude pi is a cell edge for checks and for
    # a ring's stripes, at which the colour changes as at every other edge.
    material = Material(pattern, (0.8, 0.1, 0.1), (0.1, 0.1, 0.8), cell)
    sides = []
    for angle in (math.pi - 1e-7, -math.pi + 1e-7):
        size, point = on_round(kind, angle, up)
        sides.append(colour(material, kind, size, point))
    edge = pattern == textures.CHECKED or (pattern == textures.STRIPED and kind == RING)
    red = [bool(side[0] > side[2]) for side in sides]
    assert red[0] != red[1] if edge else red[0] == red[1]


def test_albedo_of_picture_is_upright_without_mirroring():
    material = Material(textures.PICTURE, (0, 0, 0), photo="astronaut")
    photos = textures.pack([material], np.random.default_rng(0)).photos
    photo = photos[textures.PHOTOS.index("astronaut")]
    # Seen from -y with z up, x runs to the right.
    for u, v in ((0.3, 0.25), (0.7, 0.25), (0.3, 0.75), (0.55, 0.6)):
        actual = colour(material, BOX, (1.0, 0.01, 1.0), (2 * u - 1, -0.01, 2 * v - 1))
        row, col = (1 - v) * len(photo), u * len(photo)
        patch = photo[int(row) - 1 : int(row) + 1, int(col) - 1 : int(col) + 1]
        assert actual == pytest.approx(patch.mean((0, 1)), abs=0.08)
