"""Views between two cameras, and turns among several."""

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
    """Any orientation, as a quaternion of either sign, and position."""
    quaternion = np.array(draw(st.tuples(*4 * [numbers])))
    assume(np.linalg.norm(quaternion) > 0.1)
    c2w = np.eye(4)
    c2w[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    c2w[:3, 3] = draw(st.tuples(*3 * [numbers]))
    return c2w


def camera(c2w=None, **changes) -> Camera:
    return replace(Camera(K, np.eye(4) if c2w is None else c2w, 320, 240), **changes)


def at(x=0.0, y=0.0, z=0.0, turned=0.0) -> Camera:
    """A camera at a place, turned to the left by degrees."""
    c2w = np.eye(4)
    c2w[:3, :3] = Rotation.from_euler("y", -turned, degrees=True).as_matrix()
    c2w[:3, 3] = x, y, z
    return camera(c2w)


def angle(a: Camera, b: Camera) -> float:
    return Rotation.from_matrix(a.c2w[:3, :3].T @ b.c2w[:3, :3]).magnitude()


@settings(max_examples=60, deadline=None)
@given(poses(), poses(), shares, st.floats(0.5, 2))
def test_between_is_a_rigid_pose_on_the_way_the_same_from_either_end(first, second, t, zoom):
    a, b = camera(first), camera(second, K=K * [[zoom], [zoom], [1]])
    assume(angle(a, b) < np.pi - 1e-3)
    for share, end in ((0.0, a), (1.0, b)):
        made = between(a, b, share)
        np.testing.assert_allclose(made.c2w, end.c2w, atol=1e-9)
        np.testing.assert_allclose(made.K, end.K, atol=1e-9)
    made, back = between(a, b, t), between(b, a, 1 - t)
    rotation = made.c2w[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) > 0
    np.testing.assert_allclose(made.c2w, back.c2w, atol=1e-9)
    np.testing.assert_allclose(made.K, back.K, atol=1e-9)
    np.testing.assert_allclose(made.center, (1 - t) * a.center + t * b.center, atol=1e-12)
    # It turns at an even rate, the shorter way: no detour, whatever the signs of quaternions.
    assert angle(a, made) == pytest.approx(t * angle(a, b), abs=1e-6)
    assert angle(made, b) == pytest.approx((1 - t) * angle(a, b), abs=1e-6)


BALL = np.random.default_rng(0).normal(size=(4000, 3))
BALL *= 0.05 / np.linalg.norm(BALL, axis=1, keepdims=True)


@pytest.mark.parametrize("t", [0.25, 1.0])
@pytest.mark.parametrize("sizes", [((240, 320), (1280, 720)), ((300, 300), (900, 100))])
def test_a_ball_is_round_between_photographs_of_any_shapes(sizes, t):
    """By its outline at the principal point, of other places and zooms in each photograph."""
    ends, places = [], ((0.4, 0.7), (0.55, 0.3))
    for (width, height), focal, (u, v) in zip(sizes, (300, 450), places, strict=True):
        lens = np.array([[focal, 0, u * width], [0, focal, v * height], [0, 0, 1]])
        ends.append(Camera(lens, np.eye(4), width, height))
    made = between(*ends, t)
    assert (made.width, made.height) == sizes[0]
    pixels, _ = made.project(BALL + [0, 0, 5])
    wide, high = np.ptp(pixels, axis=0)
    assert wide / high == pytest.approx(1, abs=0.005)
    # In the middle of the first picture lies what lies in the middle of the second.
    middles = [np.array(size) / 2 for size in sizes]
    scale = np.sqrt(np.prod(sizes[0]) / np.prod(sizes[1]))
    off = (1 - t) * (ends[0].K[:2, 2] - middles[0]) + t * scale * (ends[1].K[:2, 2] - middles[1])
    np.testing.assert_allclose(made.K[:2, 2], middles[0] + off, atol=1e-9)
    assert made.K[0, 0] == pytest.approx((1 - t) * 300 + t * scale * 450)
    back = between(*ends[::-1], 1 - t)
    np.testing.assert_allclose(back.K[[0, 1], [0, 1]] * scale, made.K[[0, 1], [0, 1]])


@settings(max_examples=40, deadline=None)
@given(st.floats(0.05, 1.5), numbers, poses(), st.integers(2, 13))
def test_a_turn_of_two_stays_by_the_baseline_and_aims_at_one_point(baseline, lift, world, n):
    cameras = [at(-baseline / 2, lift * baseline, turned=-4), at(baseline / 2, turned=5)]
    moved = [replace(one, c2w=world @ one.c2w) for one in cameras]
    points = WALL @ world[:3, :3].T + world[:3, 3]
    turn = orbit(moved, points, n)
    assert len(turn) == n
    a, b = (one.center for one in moved)
    np.testing.assert_allclose(turn[0].center, a, atol=1e-9)
    if n % 2 == 0:
        np.testing.assert_allclose(turn[n // 2].center, b, atol=1e-9)
    half = np.linalg.norm(b - a) / 2
    axis = (b - a) / (2 * half)
    aims, ways = np.array([one.center for one in turn]), np.array([one.c2w[:3, 2] for one in turn])
    for one in turn:
        offset = one.center - (a + b) / 2
        along = offset @ axis
        across = np.linalg.norm(offset - along * axis)
        assert (along / half) ** 2 + (across / (MIN_AXIS_RATIO * half)) ** 2 == pytest.approx(
            1, abs=1e-6
        )
        rotation = one.c2w[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    # All axes meet in the point nearest to them, at the depth of points that are there to see.
    sides = np.eye(3) - ways[:, :, None] * ways[:, None]
    meeting = np.linalg.lstsq(sides.sum(0), (sides @ aims[..., None]).sum(0)[:, 0], rcond=None)[0]
    focus = np.median((points - world[:3, 3]) @ world[:3, :3], 0)[2]
    assert np.linalg.norm(np.cross(meeting - aims, ways), axis=1).max() < 1e-6 * focus


def test_a_turn_among_many_reaches_as_far_as_they_do():
    cameras = [at(x, y) for x in (-1, 0, 1) for y in (-0.6, 0.6)]
    turn = orbit(cameras, WALL, 16)
    reach = np.abs([one.center for one in turn]).max(0)
    np.testing.assert_allclose(reach, [1, 0.6, 0], atol=1e-9)


def test_a_turn_leaves_out_cameras_that_look_elsewhere():
    ring = []
    for turned in range(0, 360, 30):
        outwards = Rotation.from_euler("y", -turned, degrees=True).as_matrix()
        c2w = np.eye(4)
        c2w[:3, :3], c2w[:3, 3] = outwards, outwards @ [0, 0, -4]
        ring.append(camera(c2w))
    thing = np.random.default_rng(0).normal(size=(200, 3)) * 0.3
    for one in orbit(ring, thing, 12):
        assert np.linalg.norm(one.center) > 3  # the mean of all would stand inside the thing
        pixel, z = one.project(np.zeros(3))
        assert z > 3 and np.abs(pixel - [160, 120]).max() < 10
    assert len(orbit([at(), at(0.5, turned=60)], WALL, 4)) == 4


@pytest.mark.parametrize(
    ("path", "arguments", "sentence"),
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
def test_refused(path, arguments, sentence):
    with pytest.raises(InputError, match=sentence):
        path(*arguments)
