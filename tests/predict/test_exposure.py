"""Compensation of exposure between views."""

import numpy as np
from textured_planes import camera, make_links, sample

from slgaussian.predict.exposure import colour_gains
from slgaussian.predict.view_graph import ViewGraph

CAMERAS = (camera(turn=0.2, focal=140, principal=(70, 50)), camera(x=0.4, y=0.1, turn=-0.1))


def make_graph(*cameras):
    """Each view linked with those beside it."""
    return ViewGraph(cameras, make_links(*cameras, reach=1))


def estimate_gains(cameras, bright):
    """Gains of views of a plane that were taken with so many times the light."""
    views = sample(*cameras).context
    images = [
        ((view.image // 2 + 30) * b).round().astype(np.uint8)
        for view, b in zip(views, bright, strict=True)
    ]
    answered = [np.ones(view.depth.shape, bool) for view in views]
    return colour_gains(images, [1 / view.depth for view in views], answered, make_graph(*cameras))


def test_along_a_walk_each_view_gets_the_exposure_of_its_neighbourhood():
    bright = np.array([0.72, 0.9, 1.125])
    gains = estimate_gains([camera(x=0.2 * k) for k in range(3)], bright)
    logs = np.log(bright)
    expected = np.array([logs[:2].mean(), logs.mean(), logs[1:].mean()]) - logs
    # Whole grey levels around 90: half a level is 0.5 %.
    assert np.allclose(np.log(gains), expected[:, None], atol=0.01)


def test_one_view_that_is_far_off_the_others_hardly_moves_them():
    """The view with another exposure is adjusted to the others, not the others to it."""
    bright = np.array([1.0, 1.0, 0.7, 1.0, 1.0])
    gains = estimate_gains([camera(x=0.1 * k) for k in range(5)], bright)
    moved = np.log(gains * bright[:, None])
    # Exposures of at most USUAL pull either way; counted in full the dark one moves them by 0.12.
    assert np.abs(moved).max() < 0.05, moved


def test_without_shared_pixels_the_gains_are_one():
    views = sample(*CAMERAS).context
    nothing = [np.zeros(view.depth.shape, bool) for view in views]
    inverse_depths = [1 / view.depth for view in views]
    images = [view.image for view in views]
    gains = colour_gains(images, inverse_depths, nothing, make_graph(*CAMERAS))
    assert np.array_equal(gains, np.ones((2, 3)))
