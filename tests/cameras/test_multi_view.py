"""Estimation of cameras of three and more photographs of a procedural room."""

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benches.cameras.pose_metrics import direction_error, rotation_error
from slgaussian import datasets
from slgaussian.cameras.estimated import UNUSED, EstimatedCameras
from slgaussian.cameras.find import find_cameras, find_multi_view, worth_solving
from slgaussian.cameras.two_view import Described, Photograph, find_pair
from slgaussian.errors import InputError


@cache
def room(seed: int) -> tuple[list[Photograph], list[np.ndarray]]:
    """Make three photographs side by side, and their true world-to-camera matrices."""
    scene = datasets.load("procedural", seed=seed, height=300, width=400)
    views = [scene.read(name) for name in list(scene.cameras)[:3]]
    photographs = [Photograph(view.name, view.image, 1200, 900) for view in views]
    return photographs, [view.camera.w2c for view in views]


@pytest.fixture(scope="module")
def photographs() -> list[Photograph]:
    return room(0)[0]


@pytest.fixture(scope="module")
def estimate(photographs) -> EstimatedCameras:
    return find_cameras(photographs)


def angular_error(cameras, true) -> float:
    """Return the largest error of rotation or direction over all pairs, degrees."""
    worst = 0.0
    for j, i in combinations(range(len(true)), 2):
        actual, expected = cameras[i].w2c @ cameras[j].c2w, true[i] @ np.linalg.inv(true[j])
        turned = rotation_error(actual[:3, :3], expected[:3, :3])
        worst = max(worst, turned, direction_error(actual[:3, 3], expected[:3, 3]))
    return worst


def test_three_views_are_placed_in_the_frame_of_the_first(photographs, estimate):
    cameras = [estimate.cameras[p.name] for p in photographs]
    assert angular_error(cameras, room(0)[1]) < 4
    np.testing.assert_allclose(cameras[0].c2w, np.eye(4), atol=1e-12)
    assert np.linalg.norm(cameras[1].center) == pytest.approx(1)
    focal = estimate.focals[photographs[0].name]
    assert focal.low < 1080 < focal.high  # 360 px at a third of the size
    assert focal.pixels == cameras[2].K[0, 0]
    assert estimate.confidence > 0.9
    assert not estimate.warnings


def test_order_changes_only_the_frame(photographs, estimate):
    permuted = [photographs[k] for k in (2, 0, 1)]
    result = find_cameras(permuted)
    cameras = [result.cameras[p.name] for p in photographs]
    expected = [estimate.cameras[p.name].w2c for p in photographs]
    assert list(result.cameras) == [p.name for p in permuted]
    assert angular_error(cameras, expected) < 1e-4
    np.testing.assert_allclose(cameras[2].c2w, np.eye(4), atol=1e-12)
    name = photographs[0].name
    assert result.focals[name] == estimate.focals[name]


def test_photograph_of_another_room_is_left_out_and_changes_no_byte(photographs, estimate):
    """It shows an object of the same pattern."""
    stranger, reason = replace(room(5)[0][0], name="elsewhere.jpg"), "too little"
    result = find_cameras([photographs[0], stranger, *photographs[1:]])
    assert list(result.cameras) == [p.name for p in photographs]
    for name, camera in estimate.cameras.items():
        assert result.cameras[name].c2w.tobytes() == camera.c2w.tobytes()
    assert result.focals == estimate.focals and result.confidence == estimate.confidence
    assert list(result.left_out) == ["elsewhere.jpg"]
    assert reason in result.left_out["elsewhere.jpg"]
    (warning,) = result.warnings
    assert warning.startswith("elsewhere.jpg is left out: ") and reason in warning
    assert "cameras found of 3 of 4 photographs" in result.summary()
    assert result.as_json()["left_out"] == result.left_out


def test_first_two_photographs_of_one_place_are_refused(photographs):
    first, second, _ = photographs
    image = first.image.copy()
    image[0, 0] ^= 1
    twin = replace(first, image=image, name="twin.jpg")
    with pytest.raises(InputError, match=r"twin.jpg'.*one place"):
        find_multi_view([*map(Described.of, (first, twin, second))], find_pair)


def test_only_overlapping_photographs_are_solved_in_pairs():
    """The photographs are overlapping windows of a strip."""
    texture = np.random.default_rng(0).integers(0, 255, (60, 400, 3), dtype=np.uint8)
    strip = np.kron(texture, np.ones((4, 4, 1), np.uint8))
    windows = [Photograph(str(k), strip[:, 110 * k : 110 * k + 300], 300, 240) for k in range(7)]
    pairs = worth_solving([Described.of(window) for window in windows])
    assert {(k, k + 1) for k in range(6)} <= set(pairs)
    assert len(pairs) < 21


def test_pair_contradicted_by_the_others_is_unused(photographs):
    wrong_pair = {"view_00", "view_02"}

    def find_with_error(a, b):
        pose = find_pair(a, b)
        if {a.photograph.name, b.photograph.name} != wrong_pair:
            return pose
        turn = Rotation.from_rotvec([0, 0.5, 0]).as_matrix()
        return replace(pose, views=replace(pose.views, R=turn @ pose.views.R))

    result = find_multi_view([Described.of(p) for p in photographs], find_with_error)
    (wrong,) = (pair for pair in result.pairs if set(pair.views) == wrong_pair)
    assert wrong.verdict == UNUSED and "contradict" in wrong.reason
    assert angular_error([result.cameras[p.name] for p in photographs], room(0)[1]) < 4
