"""The predictor as a whole; hard pairs are in ``test_hard_pairs.py``."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from textured_planes import Plane, camera, sample

from slgaussian.errors import InputError
from slgaussian.predict.planesweep import PlaneSweep


def test_same_input_same_bytes():
    scene = sample(camera(), camera(x=0.3))
    first, second = PlaneSweep()(scene), PlaneSweep()(scene)
    for (_, a), (_, b) in zip(first.items(), second.items(), strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize(
    ("limits", "x", "message"),
    [
        # They overlap far away, but not at one metre.
        ({"near": 0.5, "far": 1.0}, 4.0, r"nothing in common between depths 0\.5 and 1"),
        ({"far": 1e-3}, 0.3, r"is not below far 0\.001"),
    ],
)
def test_ranges_that_show_nothing_are_refused(limits, x, message):
    with pytest.raises(InputError, match=message):
        PlaneSweep()(sample(camera(**limits), camera(x=x, **limits)))


def test_one_of_three_views_that_sees_nothing_of_the_others_in_the_range_draws_nothing():
    """Two such views are refused; a walk is not, for one of its views."""
    cameras = [camera(near=2.0, far=4.0), camera(x=0.3, near=2.0, far=4.0)]
    two = sample(*cameras)
    alternative = Plane(np.array([0.0, 0.0, 1.0]), 3.0, seed=7)
    away = alternative.view("away", camera(x=6.0, near=2.0, far=4.0))
    three = replace(two, context=(*two.context, away))
    gaussians = PlaneSweep()(three)
    local = np.bincount(gaussians.source.numpy() // three.context[0].grey.size, minlength=3)
    assert (local[:2] > 0).all()
    assert local[2] < 0.1 * three.context[0].grey.size
