"""The CPU rasterizer: Numba, parallel over tiles, blocks of 4x4 pixels, float32 sums.

Geometry is projected in float64 (:mod:`.project`), binned by tile and depth (:mod:`.tiles`) and
composited (:mod:`.blend`). The result of a tile does not depend on the thread that computes it, so
images are identical for any number of threads.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from slgaussian.gaussians import Gaussians
from slgaussian.rasterize.api import Render
from slgaussian.rasterize.blend import draw_backward
from slgaussian.rasterize.picture import GEOMETRY, draw_splats
from slgaussian.rasterize.project import Eye, make_eye, project_backward
from slgaussian.rasterize.render_settings import Settings
from slgaussian.rasterize.tiles import count_tiles
from slgaussian.scene import Camera


def render(
    gaussians: Gaussians, values: torch.Tensor, camera: Camera, settings: Settings, median: bool
) -> Render:
    """See :func:`slgaussian.rasterize.rasterize`; results are float32.

    A Gaussian that is not drawn has no gradient.
    """
    arrays = {
        name: getattr(gaussians, name).to("cpu", torch.float32).contiguous() for name in GEOMETRY
    }
    gaussians = replace(gaussians, **arrays)
    values = values.to("cpu", torch.float32).contiguous()
    eye = make_eye(camera, settings)
    image, alpha, depth, middle = _Splatting.apply(
        gaussians, eye, settings, median, *arrays.values(), values
    )
    return Render(image, alpha, depth, middle if median else None)


class _Splatting(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        gaussians: Gaussians,
        eye: Eye,
        settings: Settings,
        median: bool,
        *tensors: torch.Tensor,
    ) -> tuple[torch.Tensor, ...]:
        *geometry, values = (t.detach().numpy() for t in tensors)
        drawn, scene = draw_splats(gaussians, geometry, values, eye, settings, median)
        image, alpha, depth, middle = (torch.from_numpy(array) for array in drawn)
        if any(ctx.needs_input_grad):
            ctx.save_for_backward(*tensors, alpha, depth)
            ctx.drawn = scene, eye
        ctx.mark_non_differentiable(middle)
        return image, alpha, depth, middle

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        *geometry, _, alpha, depth = (t.detach().numpy() for t in ctx.saved_tensors)
        d_image, d_alpha, d_depth = (t.numpy() for t in upstream[:3])
        scene, eye = ctx.drawn
        # The mean depth is the composited z over alpha, so that its gradient reaches both.
        d_z = np.divide(d_depth, alpha, out=np.zeros_like(alpha), where=alpha > 0)
        firsts = count_tiles(scene.boxes)
        grads = draw_backward(
            scene, firsts, np.ascontiguousarray(d_image), d_alpha - d_z * depth, d_z
        )
        gradients = project_backward(geometry, eye, scene.splats, firsts, grads)
        return None, None, None, None, *(torch.from_numpy(array) for array in gradients)
