"""Up, floor and heights of rooms, for any axes and unit of the poses."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from slgaussian.datasets.procedural import reader
from slgaussian.geometry.room import LEVEL_TOLERANCE, find_room
from slgaussian.scene import Camera, Estimated
from tests.cameras.rendered_rooms import RenderedRoom, looking, pinhole

SIZE = 104, 144


@pytest.fixture(scope="module")
def room():
    """Cameras and true depths of a procedural room, whose floor is z = 0."""
    scene = reader.read(seed=3, height=SIZE[0], width=SIZE[1], views=2)
    views = [scene.read(name) for name in scene.cameras]
    return [view.camera for view in views], [view.depth for view in views]


def move_camera(camera: Camera, turn: np.ndarray, shift: np.ndarray, scale: float) -> Camera:
    c2w = camera.c2w.copy()
    c2w[:3, :3] = turn @ c2w[:3, :3]
    c2w[:3, 3] = scale * (turn @ c2w[:3, 3]) + shift
    return Camera(camera.K, c2w, camera.width, camera.height)


def test_find_room_finds_up_floor_and_unit(room):
    cameras, depths = room
    result = find_room(cameras, depths)
    assert result.up[2] > np.cos(np.radians(0.2))
    assert abs(result.floor) < 0.01
    assert result.unit == pytest.approx(cameras[0].c2w[2, 3], rel=0.02)
    place = result.place(cameras[0], depths[0])
    true = cameras[0].unproject(depths[0])[..., 2] / result.unit
    np.testing.assert_allclose(place.height, true, atol=0.02)
    floor, high = place.level[true < 0.01], place.level[true > 1]
    assert np.nanmedian(floor) > 0.999 and abs(np.nanmedian(high)) < 0.01


@settings(max_examples=10, deadline=None)
@given(
    st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1),
    st.floats(0.05, 20),
)
def test_find_room_is_equal_for_any_axes_and_unit(room, turn, scale):
    cameras, depths = room
    turn = Rotation.from_quat(turn).as_matrix()
    shift = np.array([3.0, -2.0, 1.0]) * scale
    changed = [move_camera(camera, turn, shift, scale) for camera in cameras]
    result = find_room(changed, [depth * np.float32(scale) for depth in depths])
    # A world axis so near to up is taken for it.
    assume(np.abs(turn[:, 2]).max() < np.cos(np.radians(LEVEL_TOLERANCE / 2)))
    # Measured: 0.08 degrees, heights off by 0.004.
    assert np.degrees(np.arccos(min(1, result.up @ turn[:, 2]))) < 0.2
    plain = find_room(cameras, depths)
    assert result.unit / scale == pytest.approx(plain.unit, rel=0.005)
    height = result.place(changed[0], depths[0] * np.float32(scale)).height
    np.testing.assert_allclose(height, plain.place(cameras[0], depths[0]).height, atol=0.01)


def test_find_room_prefers_a_world_axis_near_up(room):
    cameras, depths = room
    turn = Rotation.from_euler("x", LEVEL_TOLERANCE / 4, degrees=True).as_matrix()
    changed = [move_camera(camera, turn, np.zeros(3), 1) for camera in cameras]
    np.testing.assert_array_equal(find_room(changed, depths).up, [0, 0, 1])


@pytest.fixture(scope="module")
def pitched_cameras():
    """Two cameras pitched by 25 degrees in the first one's frame, which is rolled by 10, with true
    depths and true up."""
    eyes = np.array([[-0.3, -3.0, 1.6], [0.3, -3.0, 1.6]])
    ahead = np.array([0, 1, -np.tan(np.radians(25))])
    poses = [looking(eye, eye + ahead, roll) for eye, roll in zip(eyes, (10, 4), strict=True)]
    cameras = [pinhole(0.9 * SIZE[1], *SIZE[::-1], pose) for pose in poses]
    depths = [RenderedRoom.of(2).depth(camera) for camera in cameras]
    message = Estimated((0.8, 1.25), "guess", 0.5)
    frame = cameras[0].w2c
    result = [replace(camera, c2w=frame @ camera.c2w, estimated=message) for camera in cameras]
    return result, depths, frame[:3, 2]


def measure_angle(room, up: np.ndarray) -> float:
    return float(np.degrees(np.arccos(min(1, room.up @ up))))


def test_find_room_ignores_axes_of_estimated_cameras(pitched_cameras):
    cameras, depths, up = pitched_cameras
    result = find_room(cameras, depths)
    assert measure_angle(result, up) < 1
    assert result.floor == pytest.approx(-1.6, rel=0.02)  # the first camera is the origin
    # An axis near up, which would be taken for it if these cameras were given.
    near = np.array([np.sin(np.radians(2.5)), -np.cos(np.radians(2.5)), 0])
    level = Rotation.align_vectors([near], [up])[0].as_matrix()
    turned = [
        replace(move_camera(camera, level, np.zeros(3), 1), estimated=cameras[0].estimated)
        for camera in cameras
    ]
    assert measure_angle(find_room(turned, depths), near) < 1
    of_given_cameras = find_room([replace(camera, estimated=None) for camera in turned], depths)
    np.testing.assert_array_equal(of_given_cameras.up, [0, -1, 0])


def test_find_room_without_a_floor_has_no_heights(room):
    cameras, depths = room
    cut = [
        np.where(c.unproject(d)[..., 2] > 0.6, d, 0) for c, d in zip(cameras, depths, strict=True)
    ]
    walls = [np.where(np.arange(SIZE[0])[:, None] < SIZE[0] // 4, d, 0) for d in cut]
    result = find_room(cameras, walls)
    assert np.isnan(result.floor) and result.unit > 0
    assert np.isnan(result.place(cameras[0], walls[0]).height).all()
