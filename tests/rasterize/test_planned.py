"""Planned rendering is the rasteriser's, linear in the values, and its backward its adjoint."""

import numpy as np
import pytest
import torch

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.kernels.threads import kernels_on
from slgaussian.rasterize import rasterize
from slgaussian.rasterize.planned import plan
from slgaussian.scene import Camera

# What is left out, weights up to 1/16384 each, adds up. Measured: 3e-4 on this cloud.
TOLERANCE = 1e-3


def camera(width=45, height=37) -> Camera:
    K = np.array([[50.0, 0, width / 2], [0, 50, height / 2], [0, 0, 1]])
    return Camera(K, np.eye(4), width, height)


def cloud(n=300, seed=0) -> Gaussians:
    g = torch.Generator().manual_seed(seed)
    means = torch.randn(n, 3, generator=g) * torch.tensor([1.5, 1.0, 0.8])
    means[:, 2] += 4
    return Gaussians(
        means=means,
        scales=torch.rand(n, 3, generator=g) * 0.2 + 0.01,
        quats=torch.randn(n, 4, generator=g),
        opacities=torch.rand(n, generator=g),
        sh=torch.zeros(n, 1, 3),
        source=torch.arange(n, dtype=torch.int32),
    )


@pytest.mark.parametrize("channels", [1, 3, 6])
def test_a_plan_renders_what_the_rasteriser_renders(channels):
    splats, view = cloud(), camera()
    values = torch.rand(len(splats), channels, generator=torch.Generator().manual_seed(1))
    planned = plan(splats, view)
    drawn = rasterize(splats, values, view)
    assert (planned.render(values) - drawn.values).abs().max() < TOLERANCE
    assert torch.equal(planned.alpha, drawn.alpha)


def test_the_backward_is_the_adjoint_of_the_forward():
    splats, view = cloud(), camera()
    planned = plan(splats, view)
    g = torch.Generator().manual_seed(2)
    values = torch.rand(len(splats), 3, generator=g).requires_grad_()
    upstream = torch.rand(view.height, view.width, 3, generator=g)
    image = planned.render(values)
    (grads,) = torch.autograd.grad(image, values, upstream)
    forward = (image.detach().double() * upstream.double()).sum()
    backward = (values.detach().double() * grads.double()).sum()
    assert backward == pytest.approx(forward.item(), rel=1e-6)  # float32 sums: measured 2e-8


def test_no_gaussians_and_wrong_values():
    nothing = plan(cloud()[torch.zeros(300, dtype=torch.bool)], camera())
    assert nothing.render(torch.zeros(0, 2)).abs().max() == 0
    with pytest.raises(InputError, match=r"expected \(300, C\)"):
        plan(cloud(), camera()).render(torch.zeros(299, 2))


def test_bytes_do_not_depend_on_the_thread_count():
    splats, values = cloud(), torch.rand(300, 3, generator=torch.Generator().manual_seed(4))
    result = []
    for threads in (1, 2):
        leaf = values.clone().requires_grad_()
        with kernels_on(threads):
            image = plan(splats, camera()).render(leaf)
            result.append((image.detach(), *torch.autograd.grad(image.sum(), leaf)))
    assert all(torch.equal(a, b) for a, b in zip(*result, strict=True))
