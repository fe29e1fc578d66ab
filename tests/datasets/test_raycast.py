import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from implicit_solids import first_crossing, inside_below_zero

from slgaussian.datasets.procedural.raycast import (
    BALL,
    BOX,
    CONE,
    CYLINDER,
    RING,
    Solid,
    cast,
    normal_at,
    pack,
)

KINDS = (BOX, BALL, CYLINDER, CONE, RING)
# Over 4000 random rays at each kind, the implicit function at a hit stays below 6e-14; a root that
# is nearly double (a grazing ray) is known to the square root of that at worst.
ON_SURFACE = 1e-9


def rotation(rng: np.random.Generator) -> np.ndarray:
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    q[:, 0] *= np.linalg.det(q)
    return q


def random_solid(kind: int, rng: np.random.Generator) -> Solid:
    size = tuple(rng.uniform(0.2, 1.0, 3))
    if kind == RING:
        size = (size[0], size[0] * rng.uniform(0.1, 0.9))
    elif kind in (CYLINDER, CONE):
        size = size[:2]
    elif kind == BALL:
        size = size[:1]
    return Solid(kind, size, tuple(rng.normal(size=3)), rotation(rng))


def random_ray(solid: Solid, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    direction = rng.normal(size=3)
    origin = solid.centre + 4 * direction / np.linalg.norm(direction)
    aim = solid.centre + rng.normal(size=3) * solid.reach * 0.5
    return origin, (aim - origin) * rng.uniform(0.05, 3)


def shoot(solid: Solid, origin, ray) -> float:
    ray = np.asarray(ray, np.float64).reshape(1, 1, 3)
    t, index = cast(pack([solid]), np.asarray(origin, np.float64), ray)
    assert (index[0, 0] == 0) == np.isfinite(t[0, 0])
    return float(t[0, 0])


@given(kind=st.sampled_from(KINDS), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_a_ray_stops_where_a_dense_search_first_meets_the_surface(kind, seed):
    rng = np.random.default_rng(seed)
    solid = random_solid(kind, rng)
    origin, ray = random_ray(solid, rng)
    t = shoot(solid, origin, ray)
    expected = first_crossing(solid, origin, ray, far=8 / np.linalg.norm(ray))
    if np.isfinite(t):
        assert abs(inside_below_zero(solid, origin + t * ray)) < ON_SURFACE
        before = origin + np.linspace(0, 1, 500)[:-1, None] * t * ray
        assert inside_below_zero(solid, before).min() > -ON_SURFACE
    # The search steps by 0.002 and may jump over a sliver; the cast may not.
    if np.isfinite(expected):
        assert t <= expected + 1e-9 / np.linalg.norm(ray)


@given(kind=st.sampled_from(KINDS), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_normals_are_unit_and_along_the_gradient_of_the_implicit_function(kind, seed):
    rng = np.random.default_rng(seed)
    solid = random_solid(kind, rng)
    origin, ray = random_ray(solid, rng)
    t = shoot(solid, origin, ray)
    if not np.isfinite(t):
        return
    local = (origin + t * ray - solid.centre) @ solid.rotation
    normal = np.array(normal_at(kind, np.array((*solid.size, 0, 0)[:3], float), tuple(local)))
    assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-6)
    assert normal @ (ray @ solid.rotation) < 1e-6 * np.linalg.norm(ray)  # faces the ray
    level = Solid(solid.kind, solid.size, (0.0, 0.0, 0.0))
    steps = 1e-6 * np.eye(3)
    rise, along = (
        inside_below_zero(level, local + step) - inside_below_zero(level, local - step)
        for step in (steps, 1e-6 * normal)
    )
    if abs(np.linalg.norm(rise) - abs(along)) > 1e-9:
        return  # at an edge, where the gradient is not defined
    assert rise / np.linalg.norm(rise) @ normal == pytest.approx(1, abs=1e-6)


def test_a_cone_is_met_by_a_ray_parallel_to_its_side():
    cone = Solid(CONE, (1.0, 1.0), (0.0, 0.0, 0.0))  # base at z = -1, apex at z = 1
    # Towards the axis along a line 0.2 below the side: enters through the base.
    assert shoot(cone, (1.8, 0, -3), (-1, 0, 2)) == pytest.approx(1.0, abs=1e-12)
    # Above the other side's prolongation, it never gets in.
    assert shoot(cone, (2.2, 0, -3), (-1, 0, 2)) == math.inf


def test_the_nearest_of_many_is_the_nearest_of_each_alone():
    rng = np.random.default_rng(0)
    solids = [random_solid(kind, rng) for kind in KINDS * 3]
    origin = np.array((0, 0, 9.0))
    rays = np.concatenate([rng.uniform(-0.3, 0.3, (40, 50, 2)), -np.ones((40, 50, 1))], -1)
    t, index = cast(pack(solids), origin, rays)
    alone = np.stack([cast(pack([solid]), origin, rays)[0] for solid in solids])
    assert np.isfinite(t).mean() > 0.2
    assert (t == alone.min(0)).all()
    assert (index == np.where(np.isfinite(t), alone.argmin(0), -1)).all()
