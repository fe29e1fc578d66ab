"""Choice of context views around two: between them first, apart from targets and each other."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from slgaussian.datasets.context_views import (
    MAX_AXIS_ANGLE,
    MIN_INNER_DISTANCE,
    MIN_OUTER_DISTANCE,
    MIN_TARGET_DISTANCE,
    choose_context,
)
from slgaussian.errors import InputError
from slgaussian.scene import Camera, Scene, View

K = np.array([[20.0, 0, 12], [0, 20, 8], [0, 0, 1]])


def camera(x, turned=0.0):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("y", turned, degrees=True).as_matrix()
    pose[0, 3] = x
    return Camera(K, pose, 24, 16)


def make_scene(cameras, unreadable=()):
    def read(name):
        if name in unreadable:
            raise InputError(f"{name}: cannot be read")
        return View(name, cameras[name], np.zeros((16, 24, 3), np.uint8))

    return Scene("scene", cameras, read)


def walk(places, unreadable=()):
    """Make a scene of views along a line, named by their x."""
    return make_scene({f"{x:g}": camera(x) for x in places}, unreadable)


def test_gaps_are_halved_without_targets_neighbours_of_targets_and_unreadable_views():
    scene = walk(range(101))
    assert choose_context(scene, ["20", "60"], ["30"], 3) == ("20", "60", "40")
    assert choose_context(scene, ["20", "60"], [], 5)[3:] == ("30", "50")
    chosen = choose_context(scene, ["20", "60"], ["40", "50"], 8)
    assert min(abs(float(a) - b) for a in chosen[2:] for b in (40, 50)) >= MIN_TARGET_DISTANCE * 40
    assert chosen[2] in ("36", "44")
    third = choose_context(walk(range(101), unreadable=("40",)), ["20", "60"], [], 3)[2]
    assert third in ("39", "41")


def test_views_turned_beyond_the_limit_are_not_chosen():
    cameras = {"a": camera(0), "b": camera(1)}
    cameras["beyond"] = camera(0.5, turned=MAX_AXIS_ANGLE + 1)
    cameras["within"] = camera(0.4, turned=MAX_AXIS_ANGLE - 1)
    assert choose_context(make_scene(cameras), ["a", "b"], [], 3)[2] == "within"


@given(
    st.lists(st.integers(0, 60), min_size=12, max_size=30, unique=True),
    st.integers(3, 8),
    st.randoms(use_true_random=False),
)
def test_smaller_counts_choose_a_prefix_and_views_stay_apart(places, count, random):
    first, last, target = random.sample(places, 3)
    scene = walk(places)
    arguments = scene, [str(first), str(last)], [str(target)]
    try:
        chosen = choose_context(*arguments, count)
    except InputError:
        return
    assert choose_context(*arguments, count - 1) == chosen[:-1]
    assert len(set(chosen)) == count and str(target) not in chosen
    unit = abs(first - last)
    for k, name in enumerate(chosen[2:], 2):
        gap = min(abs(int(name) - int(earlier)) for earlier in chosen[:k])
        between = min(first, last) <= int(name) <= max(first, last)
        assert gap / unit >= (MIN_INNER_DISTANCE if between else MIN_OUTER_DISTANCE) - 1e-6
        assert abs(int(name) - target) / unit >= MIN_TARGET_DISTANCE - 1e-6
