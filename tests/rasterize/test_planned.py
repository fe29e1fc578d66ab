"""Planned rendering is the rasteriser's, linear in the values, and its backward its adjoint."""

import pytest
import torch

from slgaussian.errors import InputError
from slgaussian.kernels.threads import kernels_on
from slgaussian.rasterize import rasterize
from slgaussian.rasterize.planned import plan
from tests.rasterize.hard_cases import camera, cloud

VIEW = camera(45, 37, 50)
SPLATS, VALUES = cloud(300, size=0.2, view=VIEW, channels=6)


@pytest.mark.parametrize("channels", [1, 3, 6])
def test_a_plan_renders_what_the_rasteriser_renders(channels):
    values, planned = VALUES[:, :channels].contiguous(), plan(SPLATS, VIEW)
    drawn = rasterize(SPLATS, values, VIEW)
    # What is left out, weights up to 1/16384 each, adds up. Measured: 3e-4.
    assert (planned.render(values) - drawn.values).abs().max() < 1e-3
    assert torch.equal(planned.alpha, drawn.alpha)


def test_the_backward_is_the_adjoint_of_the_forward():
    values = VALUES.clone().requires_grad_()
    upstream = torch.rand(37, 45, 6, generator=torch.Generator().manual_seed(2))
    image = plan(SPLATS, VIEW).render(values)
    (grads,) = torch.autograd.grad(image, values, upstream)
    forward = (image.detach().double() * upstream.double()).sum()
    backward = (values.detach().double() * grads.double()).sum()
    assert backward == pytest.approx(forward.item(), rel=1e-6)  # float32 sums: measured 2e-8


def test_no_gaussians_and_wrong_values():
    assert plan(SPLATS[:0], VIEW).render(torch.zeros(0, 2)).abs().max() == 0
    with pytest.raises(InputError, match=r"expected \(300, C\)"):
        plan(SPLATS, VIEW).render(torch.zeros(299, 2))


def test_bytes_do_not_depend_on_the_thread_count():
    result = []
    for threads in (1, 2):
        leaf = VALUES.clone().requires_grad_()
        with kernels_on(threads):
            image = plan(SPLATS, VIEW).render(leaf)
            result.append((image.detach(), *torch.autograd.grad(image.sum(), leaf)))
    assert all(torch.equal(a, b) for a, b in zip(*result, strict=True))
