"""Cameras of three and more photographs of a made-up room."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slgaussian import datasets
from slgaussian.cameras.estimated import UNUSED
from slgaussian.cameras.find import find_cameras, find_multi_view, worth_solving
from slgaussian.cameras.two_view import Described, Photograph, find_pair
from slgaussian.errors import InputError


def room(seed: int) -> tuple[list[Photograph], list[np.ndarray]]:
    """Three photographs side by side, and true world-to-camera matrices."""
    scene = datasets.load("procedural", seed=seed, height=300, width=400)
    views = [scene.read(name) for name in list(scene.cameras)[:3]]
    taken = [Photograph(view.name, view.image, 1200, 900) for view in views]
    return taken, [view.camera.w2c for view in views]


@pytest.fixture(scope="module")
def photographs() -> tuple[list[Photograph], list[np.ndarray]]:
    return room(0)


@pytest.fixture(scope="module")
def found(photographs):
    return find_cameras(photographs[0])


def degrees_off(cameras, true) -> float:
    """Of the worst rotation or direction of all pairs."""
    worst = 0.0
    for i in range(len(true)):
        for j in range(i):
            ours, known = cameras[i].w2c @ cameras[j].c2w, true[i] @ np.linalg.inv(true[j])
            turn = Rotation.from_matrix(ours[:3, :3] @ known[:3, :3].T).magnitude()
            a, b = ours[:3, 3], known[:3, 3]
            way = np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))
            worst = max(worst, turn, way)
    return float(np.degrees(worst))


def test_three_views_in_the_world_of_the_first(photographs, found):
    taken, true = photographs
    cameras = [found.cameras[p.name] for p in taken]
    assert degrees_off(cameras, true) < 4
    np.testing.assert_allclose(cameras[0].c2w, np.eye(4), atol=1e-12)
    assert np.linalg.norm(cameras[1].center) == pytest.approx(1)
    focal = found.focals[taken[0].name]
    assert focal.low < 1080 < focal.high  # 360 px at a third of the size
    assert focal.pixels == found.cameras[taken[2].name].K[0, 0]
    assert found.confidence > 0.9
    assert not found.warnings


def test_the_order_changes_only_the_frame(photographs, found):
    taken, _ = photographs
    again = find_cameras([taken[k] for k in (2, 0, 1)])
    cameras = [again.cameras[p.name] for p in taken]
    known = [found.cameras[p.name].w2c for p in taken]
    assert list(again.cameras) == [taken[k].name for k in (2, 0, 1)]
    assert degrees_off(cameras, known) < 1e-4
    np.testing.assert_allclose(cameras[2].c2w, np.eye(4), atol=1e-12)
    assert again.focals[taken[0].name] == found.focals[taken[0].name]


def test_one_of_another_room_is_left_out_as_if_not_given(photographs, found):
    """It holds a thing of the same pattern."""
    taken, why = photographs[0], "too little"
    other = replace(room(5)[0][0], name="elsewhere.jpg")
    some = find_cameras([taken[0], other, *taken[1:]])
    assert list(some.cameras) == [p.name for p in taken]
    for name, camera in found.cameras.items():
        assert some.cameras[name].c2w.tobytes() == camera.c2w.tobytes()
    assert some.focals == found.focals and some.confidence == found.confidence
    assert list(some.left_out) == ["elsewhere.jpg"] and why in some.left_out["elsewhere.jpg"]
    (warning,) = some.warnings
    assert warning.startswith("elsewhere.jpg is left out: ") and why in warning
    assert "cameras found of 3 of 4 photographs" in some.summary()
    assert some.as_json()["left_out"] == some.left_out


def test_the_first_two_may_not_be_one(photographs):
    (first, second, _), _ = photographs
    image = first.image.copy()
    image[0, 0] ^= 1
    with pytest.raises(InputError, match=r"twin.jpg'.*one place"):
        find_cameras([first, replace(first, image=image, name="twin.jpg"), second])


def test_many_photographs_are_not_all_solved_with_all():
    """A strip cut into overlapping windows: each is solved with those that overlap it."""
    texture = np.random.default_rng(0).integers(0, 255, (60, 400, 3), dtype=np.uint8)
    strip = np.kron(texture, np.ones((4, 4, 1), np.uint8))
    windows = [Photograph(str(k), strip[:, 110 * k : 110 * k + 300], 300, 240) for k in range(7)]
    pairs = worth_solving([Described.of(window) for window in windows])
    assert {(k, k + 1) for k in range(6)} <= set(pairs)
    assert len(pairs) < 21


def test_a_pair_that_the_others_contradict_is_not_used(photographs):
    def wrong_once(a, b):
        pose = find_pair(a, b)
        if {a.photograph.name, b.photograph.name} != {"view_00", "view_02"}:
            return pose
        turn = Rotation.from_rotvec([0, 0.5, 0]).as_matrix()
        return replace(pose, views=replace(pose.views, R=turn @ pose.views.R))

    result = find_multi_view([Described.of(item) for item in photographs[0]], wrong_once)
    (wrong,) = (pair for pair in result.pairs if set(pair.views) == {"view_00", "view_02"})
    assert wrong.verdict == UNUSED and "contradict" in wrong.said
    cameras = [result.cameras[item.name] for item in photographs[0]]
    assert degrees_off(cameras, photographs[1]) < 4
