"""Gaussians that are optimised for a scene: real steps on a small room."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from slgaussian.benchmark.baselines.optimised import (
    BASELINES,
    MOST_PIXELS,
    fit_vectors,
    optimise,
    small,
)
from slgaussian.kernels import threads
from slgaussian.rasterize import rasterize

STEPS = 60


@pytest.fixture(scope="module")
def context(room):
    return room.sample.context


@pytest.fixture(scope="module")
def made(context):
    return optimise(context, STEPS)


def error(gaussians, view) -> float:
    drawn = rasterize(gaussians, None, view.camera).values.numpy()
    return float(np.abs(drawn - view.image / 255).mean())


def test_steps_bring_pictures_to_the_photographs(context, made):
    assert made[1].shape == (STEPS,)
    assert made[1][-6:].mean() < 0.3 * made[1][:2].mean()
    first = optimise(context, 1)[0]
    for view in context:
        assert error(made[0], view) < 0.4 * error(first, view)


def test_a_view_between_them_is_drawn_better_too(room, context, made):
    """Gaussians start where matches say: so far away, and not somewhere."""
    between = room.sample.targets[0]
    assert error(made[0], between) < 0.6 * error(optimise(context, 1)[0], between)
    _, depth = between.camera.project(made[0].means.double().numpy())
    true = between.depth[between.depth > 0]
    assert 0.5 * np.median(true) < np.median(depth) < 2 * np.median(true)


def test_the_same_scene_gives_the_same_bytes_on_any_number_of_threads(context, made):
    threads.limit(1)
    try:
        again = optimise(context, STEPS)
    finally:
        threads.limit()
    for name, values in made[0].items():
        assert torch.equal(values, getattr(again[0], name)), name
    assert np.array_equal(made[1], again[1])


def test_a_step_goes_where_the_reference_says(context):
    """The second of two steps, by the plain rasteriser's gradients in float64."""
    views = [view.resized(26, 36) for view in context]
    start, after = (optimise(views, steps)[0] for steps in (1, 2))
    assert len(after) == 2 * 13 * 18
    names = ("means", "scales", "quats", "opacities")
    leaves = {n: getattr(start, n).double().requires_grad_() for n in names}
    colours = start.colors().double().requires_grad_()
    drawn = rasterize(replace(start, **leaves), colours, views[1].camera, backend="reference")
    (drawn.values - torch.from_numpy(views[1].image / 255.0)).abs().mean().backward()
    moved = (after.means - start.means).double()
    gradient = leaves["means"].grad
    strong = gradient.abs() > gradient.abs().quantile(0.9)
    downhill = (moved[strong].sign() == -gradient[strong].sign()).double().mean()
    # Adam's second step still remembers the first one, of the other photograph.
    assert downhill > 0.8


def test_vectors_of_frozen_gaussians_are_fitted_to_images(context, made):
    views = [small(view) for view in context]
    images = []
    for view in views:
        left = np.arange(view.image.shape[1]) < view.image.shape[1] // 2
        known = np.broadcast_to(left, view.image.shape[:2]).astype(np.float32)
        images.append(np.stack([known * 0.25, known * 0.75, known], 2))
    carried, losses = fit_vectors(made[0], [view.camera for view in views], images, 80)
    assert carried.shape == (len(made[0]), 3) and carried.dtype == np.float32
    assert losses[-4:].mean() < 0.2 * losses[:2].mean()
    drawn = rasterize(made[0], torch.from_numpy(carried), views[0].camera).values.numpy()
    inside = images[0][..., 2] > 0
    np.testing.assert_allclose(np.median(drawn[inside], axis=0), [0.25, 0.75, 1.0], atol=0.1)
    assert np.median(drawn[~inside][:, 2]) < 0.2


def test_photographs_are_made_small_and_never_larger(context):
    for view in context:
        assert small(view) is view  # 104 x 144 are few
        large = view.resized(832, 1152)
        height, width = small(large).image.shape[:2]
        assert height * width <= MOST_PIXELS < 1.02 * (height + 1) * (width + 1)


def test_without_a_match_something_else_says_how_far_things_are(context):
    grey = [replace(view, image=np.full_like(view.image, 128)) for view in context]
    apart = np.linalg.norm(grey[1].camera.center - grey[0].camera.center)
    for near, far, middle in ((None, None, BASELINES * apart), (1.0, 9.0, 3.0)):
        views = [replace(v, camera=replace(v.camera, near=near, far=far)) for v in grey]
        means = optimise(views, 1)[0].means.double().numpy()
        _, depth = views[0].camera.project(means[: len(means) // 2])
        np.testing.assert_allclose(depth, middle, rtol=0.05)
