"""Metrics of estimated poses: angular errors and the area under the recall curve."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benches.cameras.pose_metrics import area_under_curve, direction_error, rotation_error


def test_errors_equal_the_known_angles():
    turn = Rotation.from_rotvec(np.radians([0, 7, 0])).as_matrix()
    assert rotation_error(turn, np.eye(3)) == pytest.approx(7)
    rounded = turn * (1 + 1e-4)
    assert rotation_error(rounded, np.eye(3)) == pytest.approx(7)
    assert rotation_error(rounded, turn) == pytest.approx(0, abs=1e-5)
    assert direction_error(turn @ [0, 0, 3.0], np.array([0, 0, 0.5])) == pytest.approx(7)
    assert direction_error(np.array([0, 0, -1.0]), np.array([0, 0, 1.0])) == pytest.approx(180)


def test_area_is_the_mean_recall_up_to_a_threshold():
    # Recall is linear between errors, as in SuperGlue and LightGlue.
    assert area_under_curve([0.0, 0.0], [5.0]) == pytest.approx([100])
    assert area_under_curve([np.inf, 30.0], [5.0, 20.0]) == pytest.approx([0, 0])
    assert area_under_curve([0.0, np.inf], [5.0]) == pytest.approx([50])
    # Recall rises from 0 to one half at 2, then stays constant.
    assert area_under_curve([2.0, np.inf], [4.0]) == pytest.approx([100 * (0.5 + 1.0) / 4])
