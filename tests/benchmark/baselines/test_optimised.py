"""Gaussians and codes that are optimised for a scene: they fit, grow, and start without matches."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from slgaussian.benchmark import metrics
from slgaussian.benchmark.baselines import optimised
from slgaussian.benchmark.baselines.drawn import draw_picture
from slgaussian.rasterize import rasterize
from slgaussian.rasterize.planned import plan


def test_gaussians_fit_their_photographs_better_with_more_steps(room):
    views = room.sample.context

    def psnr(steps: int) -> float:
        gaussians = optimised.optimise_gaussians(views, 0, steps)
        gaussians.check()
        return np.mean(
            [metrics.psnr(draw_picture(gaussians, v.camera).rgb, v.image) for v in views]
        )

    few, many = psnr(20), psnr(250)
    assert many > 16 and many > few + 2


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
    codes = np.eye(4, 3, dtype=np.float32)[ids]  # one id in three has none
    codes = codes[..., :3] * (ids < 2)[..., None]
    carried = optimised.optimise_codes(gaussians, views, codes, 500)
    drawn = plan(gaussians, views[0].camera).render(torch.from_numpy(carried)).numpy()
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
