"""The upright box around scattered points, compared with known boxes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.objects import upright_box


def turn_axes(angle: float, up: np.ndarray) -> np.ndarray:
    """Axes of a box in rows, turned about ``up``."""
    side = np.cross(up, [0.3, 0.5, -0.8])
    side /= np.linalg.norm(side)
    first = np.cos(angle) * side + np.sin(angle) * np.cross(up, side)
    return np.stack([first, np.cross(up, first), up])


def draw_points(axes: np.ndarray, halves: np.ndarray, seed: int, count: int = 2000) -> np.ndarray:
    drawn = np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    return np.array([2.0, -1.0, 5.0]) + (drawn * halves) @ axes


@given(
    st.floats(0, 3.1), st.integers(0, 20), st.sampled_from([(0, -1, 0), (0, 0, 1), (0.6, 0.8, 0)])
)
def test_upright_box_finds_a_known_box_at_any_angle(angle, seed, up):
    up = np.array(up, float)
    axes, halves = turn_axes(angle, up), np.array([0.9, 0.4, 0.25])
    box = upright_box(draw_points(axes, halves, seed), up)
    np.testing.assert_allclose(box.half_sizes, 0.94 * halves, rtol=0.1)
    np.testing.assert_allclose(box.centre, [2, -1, 5], atol=0.04)
    assert abs(box.axes[0] @ axes[0]) > np.cos(np.radians(6))
    np.testing.assert_array_equal(box.axes[2], up)
    np.testing.assert_allclose(box.axes @ box.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(box.axes) == pytest.approx(1)


def test_upright_box_ignores_points_far_off():
    up, halves = np.array([0.0, 0, 1]), np.array([0.5, 0.3, 0.2])
    good = draw_points(np.eye(3), halves, 1)
    wild = np.random.default_rng(2).normal(0, 1, (300, 3)) * [30, 30, 30]
    box = upright_box(np.concatenate([good, wild]), up)
    np.testing.assert_allclose(box.half_sizes, halves, rtol=0.1)


def test_upright_box_accepts_one_point_and_a_line():
    up = np.array([0.0, -1, 0])
    item = upright_box(np.array([[1.0, 2, 3]]), up)
    np.testing.assert_allclose(item.half_sizes, 0, atol=1e-12)
    np.testing.assert_allclose(item.centre, [1, 2, 3])
    line = upright_box(np.outer(np.linspace(0, 1, 500), [3.0, 0, 4]), up)
    np.testing.assert_allclose(line.half_sizes, [0.94 * 2.5, 0, 0], atol=0.05)
