"""One exposure for all views."""

import numpy as np
from textured_planes import camera, sample

from slgaussian.cameras.relative import Relative
from slgaussian.predict.balance import color_gains
from slgaussian.predict.links import Link

CAMERAS = (camera(turn=0.2, focal=140, principal=(70, 50)), camera(x=0.4, y=0.1, turn=-0.1))


def links_between(a, b):
    relative = Relative.between(a, b)
    none = np.zeros(0)
    return [[Link(1, relative, none)], [Link(0, relative.reversed(), none)]]


def test_gains_undo_an_exposure_difference():
    views = sample(*CAMERAS).context
    factor = np.array([0.8, 0.9, 1.1])
    images = [views[0].image // 2 + 30, None]
    images[1] = ((views[1].image // 2 + 30) * factor).round().astype(np.uint8)
    inverse_depths = [1 / view.depth for view in views]
    answered = [np.ones(view.depth.shape, bool) for view in views]
    gains = color_gains(images, inverse_depths, answered, links_between(*CAMERAS))
    # Whole grey levels around 90: half a level is 0.5 %.
    assert np.allclose(gains[0] / gains[1], factor, rtol=0.01)
    assert np.allclose(gains[0] * gains[1], 1)


def test_without_shared_pixels_the_gains_are_one():
    views = sample(*CAMERAS).context
    nothing = [np.zeros(view.depth.shape, bool) for view in views]
    inverse_depths = [1 / view.depth for view in views]
    images = [view.image for view in views]
    gains = color_gains(images, inverse_depths, nothing, links_between(*CAMERAS))
    assert np.array_equal(gains, np.ones((2, 3)))
