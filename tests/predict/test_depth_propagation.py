"""Propagation of depth to views that show the same surface."""

from dataclasses import replace

import numpy as np
from textured_planes import camera, make_links, sample

from slgaussian.predict.depth_propagation import SweptView, propagate_depth

CAMERAS = (camera(), camera(x=0.3))
LINKS = make_links(*CAMERAS)
HOLE = (slice(50, 70), slice(60, 90))


def pair():
    """Return two views with known depth, except for a hole in the first."""
    views = sample(*CAMERAS).context
    images = [np.full((*view.depth.shape, 3), 0.5, np.float32) for view in views]
    steps = np.linspace(0.05, 1, 100)
    swept = [
        SweptView(steps, 1 / view.depth.astype(np.float32), np.ones(view.depth.shape, bool))
        for view in views
    ]
    answered, guessed = swept[0].answered.copy(), swept[0].inverse_depth.copy()
    answered[HOLE], guessed[HOLE] = False, 0.9
    return views, images, [replace(swept[0], answered=answered, inverse_depth=guessed), swept[1]]


def test_a_hole_gets_the_depth_that_the_other_view_found_there():
    views, images, swept = pair()
    first, second = propagate_depth(swept, images, LINKS)
    assert first.answered[HOLE].mean() > 0.98
    inside = first.answered[HOLE]
    result, true = first.inverse_depth[HOLE][inside], 1 / views[0].depth[HOLE][inside]
    # A point may land half a pixel beside: the planes are tilted by less than 1 % a pixel.
    assert np.abs(result / true - 1).max() < 0.02
    assert np.array_equal(second.inverse_depth, swept[1].inverse_depth)
    mine = swept[0].answered  # answers are not overruled
    assert np.array_equal(first.inverse_depth[mine], swept[0].inverse_depth[mine])


def test_what_has_another_colour_is_not_believed():
    """A point of another colour may be hidden in the view."""
    _, images, swept = pair()
    images[0][40:80, 50:100] = 0.8
    first, _ = propagate_depth(swept, images, LINKS)
    assert not first.answered[53:67, 63:87].any()
