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
    image, alpha, depth, middle = _Splatting.apply(
        *arrays.values(), values, gaussians, make_eye(camera, settings), settings, median
    )
    return Render(image, alpha, depth, middle if median else None)


class _Splatting(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means: torch.Tensor,
        scales: torch.Tensor,
        quats: torch.Tensor,
        opacities: torch.Tensor,
        values: torch.Tensor,
        gaussians: Gaussians,
        eye: Eye,
        settings: Settings,
        median: bool,
    ) -> tuple[torch.Tensor, ...]:
        arrays = [t.detach().numpy() for t in (means, scales, quats, opacities)]
        drawn, scene = draw_splats(
            gaussians, arrays, values.detach().numpy(), eye, settings, median
        )
        image, alpha, depth, middle = (torch.from_numpy(array) for array in drawn)
        if any(ctx.needs_input_grad):
            ctx.save_for_backward(means, scales, quats, opacities, values, alpha, depth)
            ctx.drawn = scene, eye
        ctx.mark_non_differentiable(middle)
        return image, alpha, depth, middle

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(
        ctx: Any,
        d_image: torch.Tensor,
        d_alpha: torch.Tensor,
        d_depth: torch.Tensor,
        *_: torch.Tensor,
    ) -> tuple[torch.Tensor | None, ...]:
        *geometry, _, alpha, depth = (t.detach().numpy() for t in ctx.saved_tensors)
        scene, eye = ctx.drawn
        # The mean depth is the composited z over alpha.
        d_z = np.divide(d_depth.numpy(), alpha, out=np.zeros_like(alpha), where=alpha > 0)
        d_accumulated = d_alpha.numpy() - d_z * depth
        firsts = count_tiles(scene.boxes)
        upstream = np.ascontiguousarray(d_image.numpy()), d_accumulated, d_z
        grads = draw_backward(scene, firsts, *upstream)
        gradients = project_backward(geometry, eye, scene.splats, firsts, grads)
        return *(torch.from_numpy(array) for array in gradients), None, None, None, None
