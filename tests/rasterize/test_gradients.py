"""Gradients: the reference by finite differences, the fast path against the reference."""

from dataclasses import replace

import numba
import numpy as np
import pytest
import torch

from slgaussian.gaussians import Gaussians
from slgaussian.rasterize import Settings, rasterize
from slgaussian.scene import Camera

FIELDS = ("means", "scales", "quats", "opacities")
# Relative to the largest of each field, float32 sums. Measured: at most 6e-7 with nothing cut.
EXACT = 2e-5
# What is cut carries gradient too. Measured: 1e-2 for the geometry of 60 splats.
FAST = 5e-2


def camera() -> Camera:
    """Skew, and a principal point off the middle of an image that no tile fits."""
    K = np.array([[40.0, 1.5, 18], [0, 42, 13], [0, 0, 1]])
    return Camera(K, np.eye(4), 41, 37)


def cloud(n=60, seed=0) -> tuple[Gaussians, torch.Tensor]:
    g = torch.Generator().manual_seed(seed)
    means = torch.randn(n, 3, generator=g) * torch.tensor([1.0, 1.0, 0.8])
    means[:, 2] += 4
    made = Gaussians(
        means=means,
        scales=torch.rand(n, 3, generator=g) * 0.3 + 0.01,
        quats=torch.randn(n, 4, generator=g),
        opacities=torch.rand(n, generator=g),
        sh=torch.zeros(n, 1, 3),
        source=torch.arange(n, dtype=torch.int32),
    )
    return made, torch.rand(n, 5, generator=g)


def gradients(made, values, backend, settings, with_depth=True):
    dtype = torch.float64 if backend == "reference" else torch.float32
    leaves = [getattr(made, name).to(dtype).clone().requires_grad_() for name in FIELDS]
    carried = values.to(dtype).clone().requires_grad_()
    free = replace(made, **dict(zip(FIELDS, leaves, strict=True)))
    drawn = rasterize(free, carried, camera(), backend=backend, settings=settings)
    outputs = [drawn.values, drawn.alpha] + ([drawn.depth] if with_depth else [])
    g = torch.Generator().manual_seed(7)
    upstream = [torch.rand(output.shape, generator=g).to(dtype) for output in outputs]
    return torch.autograd.grad(outputs, [*leaves, carried], upstream)


def worst(made, values, settings, with_depth=True) -> float:
    fast, true = (
        gradients(made, values, backend, settings, with_depth) for backend in ("cpu", "reference")
    )
    assert all(torch.isfinite(grad).all() for grad in fast)
    return max(
        float((a.double() - b).abs().max() / b.abs().max().clamp_min(1e-12))
        for a, b in zip(fast, true, strict=True)
    )


NOTHING_CUT = Settings(alpha_min=0, pass_min=0)


@pytest.mark.parametrize("settings", [NOTHING_CUT, replace(NOTHING_CUT, compensate=True)])
def test_the_reference_has_the_gradient_of_what_it_draws(settings):
    made, values = cloud(3)
    small = Camera(np.array([[9.0, 0.5, 4], [0, 8, 3], [0, 0, 1]]), np.eye(4), 7, 5)

    def draw(means, scales, quats, opacities, carried):
        free = replace(made, means=means, scales=scales, quats=quats, opacities=opacities)
        drawn = rasterize(free, carried, small, backend="reference", settings=settings)
        return drawn.values, drawn.alpha, drawn.depth

    inputs = [getattr(made, name).double().requires_grad_() for name in FIELDS]
    assert torch.autograd.gradcheck(draw, [*inputs, values.double().requires_grad_()])


@pytest.mark.parametrize("settings", [NOTHING_CUT, replace(NOTHING_CUT, compensate=True)])
def test_the_fast_path_has_the_gradients_of_the_reference(settings):
    assert worst(*cloud(), settings) < EXACT


def test_with_the_default_cut_offs_gradients_stay_close():
    # Not of the depth: at the rim of a splat it is decided by what is cut.
    assert worst(*cloud(), "fast", with_depth=False) < FAST


def test_opaque_splats_in_front():
    made, values = cloud()
    made.opacities[:20] = 1.0
    made.opacities[20:40] = 1 - 1e-7
    assert worst(made, values, NOTHING_CUT) < EXACT


def test_needles():
    made, values = cloud()
    made.scales[:, 1:] = 1e-6
    assert worst(made, values, NOTHING_CUT, with_depth=False) < 1e-3


def test_what_is_not_drawn_has_no_gradient():
    made, values = cloud(20)
    made.means[:10, 2] = -3.0
    made.opacities[10:12] = 0.0
    found = gradients(made, values, "cpu", "fast")
    for grad in found:
        assert torch.isfinite(grad).all()
        assert grad[:12].abs().max() == 0
    assert found[0][12:].abs().max() > 0


def test_harmonics_get_gradients_through_the_colours():
    made, _ = cloud(20)
    sh = torch.rand(20, 4, 3, generator=torch.Generator().manual_seed(1)).requires_grad_()
    drawn = rasterize(replace(made, sh=sh), None, camera())
    (grad,) = torch.autograd.grad(drawn.values.sum(), sh)
    assert grad.abs().max() > 0


def test_bytes_do_not_depend_on_the_thread_count():
    made, values = cloud(300)
    before = numba.get_num_threads()
    found = []
    try:
        for threads in (1, before):
            numba.set_num_threads(threads)
            found.append(gradients(made, values, "cpu", "fast"))
    finally:
        numba.set_num_threads(before)
    assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))
