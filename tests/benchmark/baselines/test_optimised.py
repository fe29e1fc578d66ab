"""Gaussians and codes that are optimised for a scene: they fit, grow, and start without matches."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from slgaussian.benchmark import metrics
from slgaussian.benchmark.baselines import optimised
from slgaussian.benchmark.baselines.drawn import draw_picture
from slgaussian.rasterize import rasterize


def test_gaussians_fit_their_photographs_better_with_more_steps(room):
    views = room.sample.context
    few, many = (optimised.optimise_gaussians(views, 0, steps) for steps in (20, 250))
    many.check()
    before, after = (
        np.mean([metrics.psnr(draw_picture(g, v.camera).rgb, v.image) for v in views])
        for g in (few, many)
    )
    assert after > 16 and after > before + 2 and len(many) > len(few)


def test_a_refinement_clones_splits_and_removes():
    deviation, opacity = torch.tensor([0.1, 0.1, 2, 2]), torch.tensor([0.5, 0.001, 0.5, 0.5])
    parameters = {
        "means": torch.arange(4.0)[:, None].repeat(1, 3) * 100,
        "scales": deviation.log()[:, None].repeat(1, 3),
        "quats": torch.eye(4)[[0, 0, 0, 0]],
        "opacities": opacity.logit(),
        "sh": torch.zeros(4, 1, 3),
    }
    doubles = torch.tensor([True, True, True, False])
    refined = optimised._refined(parameters, doubles, 1.0, torch.Generator().manual_seed(0))
    x = refined["means"][:, 0]
    # The first twice in its place, none of the faint one, halves of the third beside it.
    assert sorted((x / 100).round().tolist()) == [0, 0, 2, 2, 3]
    assert x.unique().tolist()[0] == 0 and len(x.unique()) == 4
    widths = refined["scales"].exp()[:, 0]
    assert torch.allclose(widths[(x / 100).round() == 2], torch.tensor(2 / 1.6))
    assert torch.allclose(widths[(x / 100).round() != 2], torch.tensor([0.1, 2, 0.1]))


def test_photographs_without_matches_start_at_random(room):
    views = [replace(v, image=np.full_like(v.image, 90)) for v in room.sample.context]
    gaussians = optimised.optimise_gaussians(views, 0, 5)
    assert len(gaussians) >= optimised.LEAST_POINTS
    for view in views:
        _, depth = view.camera.project(gaussians.means.numpy().astype(float))
        assert (depth > 0).mean() > 0.9


def test_codes_are_recovered_through_the_renderer(room):
    views, gaussians = room.sample.context, room.gaussians
    ids = room.label_maps.labels % 3
    codes = np.eye(4, 3, dtype=np.float32)[ids]
    codes *= (ids < 2)[..., None]  # one id in three has none
    carried = optimised.optimise_codes(gaussians, views, codes, 500)
    drawn = rasterize(gaussians, torch.from_numpy(carried), views[0].camera).values.numpy()
    known = codes[0].any(-1)
    assert (drawn[known].argmax(-1) == codes[0][known].argmax(-1)).mean() > 0.97


def test_pixel_gradients_are_those_of_the_projected_centre(room):
    """Against differences of the loss, of the Gaussian with the largest gradient."""
    view, gaussians = room.sample.context[0], room.gaussians
    photograph = torch.from_numpy(view.image.astype(np.float32) / 255)
    means = gaussians.means.clone().requires_grad_()

    def loss(means: torch.Tensor) -> torch.Tensor:
        drawn = rasterize(replace(gaussians, means=means), None, view.camera, settings="exact")
        return ((drawn.values - photograph) ** 2).sum()

    loss(means).backward()
    lengths = optimised._pixel_gradients(means, view).numpy()
    number = int(lengths.argmax())
    depth = view.camera.project(means[number].detach().numpy().astype(float))[1]
    slopes = []
    for axis, size in enumerate((view.camera.width, view.camera.height)):
        step = torch.zeros_like(means)
        pixel = float(depth / view.camera.K[axis, axis])
        step[number] = torch.from_numpy(view.camera.c2w[:3, axis]).float() * pixel * 0.01
        with torch.no_grad():
            slopes.append(float(loss(means + step) - loss(means - step)) / 0.02 * size / 2)
    assert np.hypot(*slopes) == pytest.approx(lengths[number], rel=0.05)
