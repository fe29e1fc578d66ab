"""The measures that found cameras are judged by."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benches.cameras.pose_metrics import area_under_curve, direction_error, rotation_error
from benches.cameras.road_without_poses import similarity
from slgaussian.scene import Camera


def test_angles_are_those_that_were_turned():
    turn = Rotation.from_rotvec(np.radians([0, 7, 0])).as_matrix()
    assert rotation_error(turn, np.eye(3)) == pytest.approx(7)
    rounded = turn * (1 + 1e-4)
    assert rotation_error(rounded, np.eye(3)) == pytest.approx(7)
    assert rotation_error(rounded, turn) == pytest.approx(0, abs=1e-5)
    assert direction_error(turn @ [0, 0, 3.0], np.array([0, 0, 0.5])) == pytest.approx(7)
    assert direction_error(np.array([0, 0, -1.0]), np.array([0, 0, 1.0])) == pytest.approx(180)


def test_area_is_the_mean_recall_over_bounds():
    # The share of pairs below a bound, linear between errors, as SuperGlue and LightGlue draw it.
    assert area_under_curve([0.0, 0.0], [5.0]) == pytest.approx([100])
    assert area_under_curve([np.inf, 30.0], [5.0, 20.0]) == pytest.approx([0, 0])
    assert area_under_curve([0.0, np.inf], [5.0]) == pytest.approx([50])
    # Recall rises from 0 to one half at 2, then stays.
    assert area_under_curve([2.0, np.inf], [4.0]) == pytest.approx([100 * (0.5 + 1.0) / 4])


def test_a_target_is_brought_along_with_the_context():
    rng = np.random.default_rng(0)
    turn, scale, shift = Rotation.random(random_state=1).as_matrix(), 2.5, np.array([3, -1, 2.0])
    given, moved = [], []
    for R in Rotation.random(2, random_state=2).as_matrix():
        c2w, there = np.eye(4), np.eye(4)
        c2w[:3] = np.c_[R, rng.normal(size=3)]
        there[:3] = np.c_[turn @ R, scale * turn @ c2w[:3, 3] + shift]
        for cameras, pose in ((given, c2w), (moved, there)):
            cameras.append(Camera(np.diag([50.0, 50, 1]), pose, 64, 48))
    found = similarity(given, moved)
    for known, true in zip(found, (scale, turn, shift), strict=True):
        np.testing.assert_allclose(known, true, atol=1e-9)
