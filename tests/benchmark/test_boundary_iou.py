import numpy as np
import plain
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from slgaussian.benchmark.metrics import boundary_iou, reach, rim

MASKS = arrays(bool, st.tuples(st.integers(1, 70), st.integers(1, 90)))


@given(MASKS, st.integers(0, 2**32 - 1))
def test_boundary_iou_is_that_of_pixel_by_pixel_erosion(mask, seed):
    other = mask ^ (np.random.default_rng(seed).random(mask.shape) < 0.1)
    assert boundary_iou(mask, other) == plain.boundary_iou(mask, other)
    assert boundary_iou(mask, mask) == 1.0


def test_the_distance_is_a_share_of_the_diagonal():
    assert (reach(416, 576), reach(480, 640), reach(1, 1)) == (14, 16, 1)


def test_the_rim_of_a_rectangle():
    mask = np.zeros((416, 576), bool)
    mask[100:200, 150:300] = True
    inner = np.zeros_like(mask)
    inner[114:186, 164:286] = True
    assert np.array_equal(rim(mask), mask & ~inner)


def test_the_edge_of_the_image_is_an_edge():
    whole = np.ones((416, 576), bool)
    assert rim(whole)[:14].all() and not rim(whole)[14:-14, 14:-14].any()


@pytest.mark.parametrize("pixel", [(0, 0), (415, 575), (200, 300)])
def test_a_mask_of_one_pixel_is_its_own_rim(pixel):
    mask = np.zeros((416, 576), bool)
    mask[pixel] = True
    assert np.array_equal(rim(mask), mask)
    empty = np.zeros_like(mask)
    assert boundary_iou(mask, empty) == boundary_iou(empty, mask) == 0.0
    assert boundary_iou(empty, empty) == 1.0
