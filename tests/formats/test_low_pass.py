"""Gaussians for viewers: the filter of the rasteriser in their scales."""

import numpy as np

from slgaussian.benchmark.metrics import psnr
from slgaussian.datasets import load
from slgaussian.formats.low_pass import include_low_pass
from slgaussian.predict import load_predictor
from slgaussian.rasterize import rasterize
from slgaussian.rasterize.render_settings import Settings
from tests.formats.test_ply import make_gaussians


def test_include_low_pass_draws_without_a_filter_what_the_filter_drew():
    sample = load("procedural", seed=1, views=2, height=90, width=120).sample(
        ["view_00", "view_01"], []
    )
    gaussians = load_predictor("planesweep")(sample)
    cameras = [view.camera for view in sample.context]
    wide, unfiltered = include_low_pass(gaussians, cameras), Settings(low_pass=1e-6)
    assert (wide.scales > gaussians.scales).all()
    for camera in cameras:
        true = 255 * rasterize(gaussians, None, camera).values.numpy()
        errors = [
            psnr(255 * rasterize(each, None, camera, settings=unfiltered).values.numpy(), true)
            for each in (gaussians, wide)
        ]
        assert errors[0] < 25 and errors[1] > 40, errors


def test_include_low_pass_leaves_gaussians_of_no_pixel():
    of_another_program = make_gaussians(5, source=np.full(5, -1, np.int32))
    assert include_low_pass(of_another_program, []) is of_another_program
