import numpy as np
import plain
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from slgaussian.benchmark.metrics import boundary_iou, reach

MASKS = arrays(bool, st.tuples(st.integers(1, 70), st.integers(1, 90)))


@given(MASKS, st.integers(0, 2**32 - 1))
def test_boundary_iou_is_that_of_pixel_by_pixel_erosion(mask, seed):
    other = mask ^ (np.random.default_rng(seed).random(mask.shape) < 0.1)
    assert boundary_iou(mask, other) == plain.boundary_iou(mask, other)
    assert boundary_iou(mask, mask) == 1.0


def test_the_distance_is_a_share_of_the_diagonal():
    assert (reach(416, 576), reach(480, 640), reach(1, 1)) == (14, 16, 1)
