"""Interpolation between two cameras, and orbits among several."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from slgaussian.cameras.paths import MIN_AXIS_RATIO, between, orbit
from slgaussian.errors import InputError
from slgaussian.scene import Camera

K = np.array([[300.0, 0, 160], [0, 310, 120], [0, 0, 1]])
WALL = np.stack(np.meshgrid(*2 * [np.linspace(-3, 3, 21)], [5.0]), -1).reshape(-1, 3)
"""Points of a plane 5 before a camera at the origin."""

numbers = st.floats(-3, 3, allow_nan=False)
shares = st.floats(0, 1)


@st.composite
def poses(draw):
    """Draw an orientation, as a quaternion of either sign, and a position."""
    quaternion = np.array(draw(st.tuples(*4 * [numbers])))
    assume(np.linalg.norm(quaternion) > 0.1)
    c2w = np.eye(4)
    c2w[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    c2w[:3, 3] = draw(st.tuples(*3 * [numbers]))
    return c2w


def camera(c2w: np.ndarray, K: np.ndarray = K) -> Camera:
    return Camera(K, c2w, 320, 240)


def at(x=0.0, y=0.0, turned=0.0) -> Camera:
    """Return a camera at a position, turned left by degrees."""
    c2w = np.eye(4)
    c2w[:3, :3] = Rotation.from_euler("y", -turned, degrees=True).as_matrix()
    c2w[:2, 3] = x, y
    return camera(c2w)


def angle(a: Camera, b: Camera) -> float:
    return Rotation.from_matrix(a.c2w[:3, :3].T @ b.c2w[:3, :3]).magnitude()


@settings(max_examples=60, deadline=None)
@given(poses(), poses(), shares, st.floats(0.5, 2))
def test_interpolated_pose_is_rigid_uniform_and_symmetric(first, second, t, zoom):
    a, b = camera(first), camera(second, K=K * [[zoom], [zoom], [1]])
    assume(angle(a, b) < np.pi - 1e-3)
    middle = between(a, b, t)
    for actual, expected in (
        (between(a, b, 0.0), a), (between(a, b, 1.0), b), (between(b, a, 1 - t), middle),
    ):  # fmt: skip
        np.testing.assert_allclose(actual.c2w, expected.c2w, atol=1e-9)
        np.testing.assert_allclose(actual.K, expected.K, atol=1e-9)
    rotation = middle.c2w[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) > 0
    np.testing.assert_allclose(middle.center, (1 - t) * a.center + t * b.center, atol=1e-12)
    # The rotation takes the shorter way, whatever the signs of quaternions.
    assert angle(a, middle) == pytest.approx(t * angle(a, b), abs=1e-6)
    assert angle(middle, b) == pytest.approx((1 - t) * angle(a, b), abs=1e-6)


BALL = np.random.default_rng(0).normal(size=(4000, 3))
BALL *= 0.05 / np.linalg.norm(BALL, axis=1, keepdims=True)


@pytest.mark.parametrize("t", [0.25, 1.0])
@pytest.mark.parametrize("sizes", [((240, 320), (1280, 720)), ((300, 300), (900, 100))])
def test_ball_stays_round_between_photographs_of_different_shapes(sizes, t):
    """Focal lengths and principal points differ too."""
    ends, centers = [], ((0.4, 0.7), (0.55, 0.3))
    for (width, height), focal, (u, v) in zip(sizes, (300, 450), centers, strict=True):
        lens = np.array([[focal, 0, u * width], [0, focal, v * height], [0, 0, 1]])
        ends.append(Camera(lens, np.eye(4), width, height))
    actual = between(*ends, t)
    assert (actual.width, actual.height) == sizes[0]
    pixels, _ = actual.project(BALL + [0, 0, 5])
    width, height = np.ptp(pixels, axis=0)
    assert width / height == pytest.approx(1, abs=0.005)
    # Middles of the two images are aligned, and areas equal.
    middles = [np.array(size) / 2 for size in sizes]
    scale = np.sqrt(np.prod(sizes[0]) / np.prod(sizes[1]))
    offsets = [end.K[:2, 2] - middle for end, middle in zip(ends, middles, strict=True)]
    center = middles[0] + (1 - t) * offsets[0] + t * scale * offsets[1]
    np.testing.assert_allclose(actual.K[:2, 2], center, atol=1e-9)
    assert actual.K[0, 0] == pytest.approx((1 - t) * 300 + t * scale * 450)
    reverse = between(*ends[::-1], 1 - t)
    np.testing.assert_allclose(reverse.K[[0, 1], [0, 1]] * scale, actual.K[[0, 1], [0, 1]])


@settings(max_examples=40, deadline=None)
@given(st.floats(0.05, 1.5), numbers, poses(), st.integers(2, 13))
def test_orbit_of_two_is_an_ellipse_about_the_baseline_aimed_at_one_point(baseline, lift, world, n):
    pair = at(-baseline / 2, lift * baseline, turned=-4), at(baseline / 2, turned=5)
    pair = [replace(end, c2w=world @ end.c2w) for end in pair]
    points = WALL @ world[:3, :3].T + world[:3, 3]
    path = orbit(pair, points, n)
    assert len(path) == n
    a, b = (end.center for end in pair)
    np.testing.assert_allclose(path[0].center, a, atol=1e-9)
    if n % 2 == 0:
        np.testing.assert_allclose(path[n // 2].center, b, atol=1e-9)
    half = np.linalg.norm(b - a) / 2
    axis = (b - a) / (2 * half)
    for step in path:
        offset = step.center - (a + b) / 2
        along = offset @ axis
        across = np.linalg.norm(offset - along * axis)
        assert (along / half) ** 2 + (across / (MIN_AXIS_RATIO * half)) ** 2 == pytest.approx(
            1, abs=1e-6
        )
        rotation = step.c2w[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    # All optical axes pass through the point nearest to them.
    centers, axes = (np.array([step.c2w[:3, k] for step in path]) for k in (3, 2))
    sides = np.eye(3) - axes[:, :, None] * axes[:, None]
    target = np.linalg.lstsq(sides.sum(0), (sides @ centers[..., None]).sum(0)[:, 0], rcond=None)[0]
    depth = np.median((points - world[:3, 3]) @ world[:3, :3], 0)[2]
    assert np.linalg.norm(np.cross(target - centers, axes), axis=1).max() < 1e-6 * depth


def test_orbit_of_many_cameras_has_their_extent():
    cameras = [at(x, y) for x in (-1, 0, 1) for y in (-0.6, 0.6)]
    extent = np.abs([step.center for step in orbit(cameras, WALL, 16)]).max(0)
    np.testing.assert_allclose(extent, [1, 0.6, 0], atol=1e-9)


def test_orbit_leaves_out_cameras_that_look_elsewhere():
    inward = []
    for turned in range(0, 360, 30):
        outwards = Rotation.from_euler("y", -turned, degrees=True).as_matrix()
        c2w = np.eye(4)
        c2w[:3, :3], c2w[:3, 3] = outwards, outwards @ [0, 0, -4]
        inward.append(camera(c2w))
    cloud = np.random.default_rng(0).normal(size=(200, 3)) * 0.3
    for step in orbit(inward, cloud, 12):
        assert np.linalg.norm(step.center) > 3  # The mean of all cameras is inside the object.
        pixel, z = step.project(np.zeros(3))
        assert z > 3 and np.abs(pixel - [160, 120]).max() < 10
    assert len(orbit([at(), at(0.5, turned=60)], WALL, 4)) == 4


@pytest.mark.parametrize(
    ("function", "arguments", "refusal"),
    [
        (between, (at(), at(1.0), -0.1), "from 0 to 1"),
        (between, (at(), at(1.0), 1.001), "from 0 to 1"),
        (between, (at(), at(1.0), float("nan")), "from 0 to 1"),
        (between, (at(), at(1.0, turned=180), 0.5), "half a turn"),
        (orbit, ([at(), at(1.0)], WALL, 1), "at least two"),
        (orbit, ([at()], WALL, 8), "at least two"),
        (orbit, ([at(), at()], WALL, 8), "in one place"),
        (orbit, ([at(), at(1.0)], -WALL, 8), "nothing lies before"),
    ],
)
def test_invalid_arguments_are_refused(function, arguments, refusal):
    with pytest.raises(InputError, match=refusal):
        function(*arguments)
