"""Ray casting of solids against a dense search and the gradient of their implicit functions."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from implicit_solids import first_crossing, implicit_value

from slgaussian.datasets.procedural import raycast
from slgaussian.datasets.procedural.raycast import BALL, BOX, CONE, CYLINDER, RING, Solid, pack

KINDS = (BOX, BALL, CYLINDER, CONE, RING)
# Over 4000 random rays at each kind, the implicit function at a hit stays below 6e-14; for a nearly
# double root (a grazing ray) the square root of that is the worst case.
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
    t, index = raycast.cast(pack([solid]), np.asarray(origin, np.float64), ray)
    assert (index[0, 0] == 0) == np.isfinite(t[0, 0])
    return float(t[0, 0])


@given(kind=st.sampled_from(KINDS), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_ray_stops_at_the_first_crossing_of_a_dense_search(kind, seed):
    rng = np.random.default_rng(seed)
    solid = random_solid(kind, rng)
    origin, ray = random_ray(solid, rng)
    t = shoot(solid, origin, ray)
    expected = first_crossing(solid, origin, ray, far=8 / np.linalg.norm(ray))
    if np.isfinite(t):
        assert abs(implicit_value(solid, origin + t * ray)) < ON_SURFACE
        before = origin + np.linspace(0, 1, 500)[:-1, None] * t * ray
        assert implicit_value(solid, before).min() > -ON_SURFACE
    # The search may jump over a sliver, as it steps by 0.002; the cast may not.
    if np.isfinite(expected):
        assert t <= expected + 1e-9 / np.linalg.norm(ray)


@given(kind=st.sampled_from(KINDS), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_normals_are_unit_gradients_of_the_implicit_function(kind, seed):
    rng = np.random.default_rng(seed)
    solid = random_solid(kind, rng)
    origin, ray = random_ray(solid, rng)
    t = shoot(solid, origin, ray)
    if not np.isfinite(t):
        return
    local = (origin + t * ray - solid.centre) @ solid.rotation
    size = np.array((*solid.size, 0, 0)[:3], float)
    normal = np.array(raycast.normal_at(kind, size, tuple(local)))
    assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-6)
    assert normal @ (ray @ solid.rotation) < 1e-6 * np.linalg.norm(ray)  # faces the ray
    level = Solid(solid.kind, solid.size, (0.0, 0.0, 0.0))
    steps = 1e-6 * np.eye(3)
    rise, along = (
        implicit_value(level, local + step) - implicit_value(level, local - step)
        for step in (steps, 1e-6 * normal)
    )
    if abs(np.linalg.norm(rise) - abs(along)) > 1e-9:
        return  # The gradient is undefined at an edge.
    assert rise / np.linalg.norm(rise) @ normal == pytest.approx(1, abs=1e-6)


def test_ray_parallel_to_the_side_of_a_cone():
    cone = Solid(CONE, (1.0, 1.0), (0.0, 0.0, 0.0))  # base at z = -1, apex at z = 1
    # 0.2 below the side, the ray enters through the base.
    assert shoot(cone, (1.8, 0, -3), (-1, 0, 2)) == pytest.approx(1.0, abs=1e-12)
    # Above the prolonged side, it misses.
    assert shoot(cone, (2.2, 0, -3), (-1, 0, 2)) == math.inf


def test_nearest_hit_of_many_solids_equals_that_of_separate_casts():
    rng = np.random.default_rng(0)
    solids = [random_solid(kind, rng) for kind in KINDS * 3]
    origin = np.array((0, 0, 9.0))
    rays = np.concatenate([rng.uniform(-0.3, 0.3, (40, 50, 2)), -np.ones((40, 50, 1))], -1)
    t, index = raycast.cast(pack(solids), origin, rays)
    separate = np.stack([raycast.cast(pack([solid]), origin, rays)[0] for solid in solids])
    assert np.isfinite(t).mean() > 0.2
    assert (t == separate.min(0)).all()
    assert (index == np.where(np.isfinite(t), separate.argmin(0), -1)).all()
