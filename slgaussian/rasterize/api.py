"""The public function :func:`rasterize` and the model that all backends share.

A Gaussian is projected by the local affine approximation of perspective (Zwicker et al., "EWA
splatting", 2001), widened by a low-pass filter, and composited front to back by the depth of its
centre (paper, eq. 2): ``F(v) = sum_i f_i a_i prod_{j<i} (1 - a_j)``. The order is that of z
rounded to float32, and of the index where these are equal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slgaussian.components.registry import resolve
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians, first_not_finite
from slgaussian.io import short_repr
from slgaussian.rasterize.render_settings import Settings, find_settings
from slgaussian.scene import Camera

if TYPE_CHECKING:
    import torch

BACKENDS = {
    "cpu": "slgaussian.rasterize.cpu:render",
    "cuda": "slgaussian.rasterize.cuda:render",
    "reference": "slgaussian.rasterize.reference:render",
}

FRUSTUM_MARGIN = 0.3
"""Distance from the image, as a fraction of half its size, to which the point of evaluation of the
affine approximation is clamped; farther outside it diverges (Kerbl et al. 2023 and gsplat use the
same fraction)."""


@dataclass(frozen=True, eq=False)
class Render:
    """A rendered view.

    Attributes:
        values: float [H, W, C]. Composited values, premultiplied: divide by ``alpha`` for their
            weighted mean.
        alpha: float [H, W]. Accumulated opacity in [0, 1].
        depth: float [H, W]. Expected z-depth, the weighted mean, scene units; 0 where ``alpha`` is
            0.
        median: float [H, W] or None. Median z-depth: of the Gaussian at which ``alpha`` reaches one
            half; 0 where it does not. Without gradient.
    """

    values: torch.Tensor
    alpha: torch.Tensor
    depth: torch.Tensor
    median: torch.Tensor | None = None

    __repr__ = short_repr


def rasterize(
    gaussians: Gaussians,
    values: torch.Tensor | None,
    camera: Camera,
    *,
    backend: str = "auto",
    settings: Settings | str = "fast",
    median: bool = False,
) -> Render:
    """Render any number of channels of ``gaussians`` from ``camera`` in one pass.

    Differentiable in the means, scales, quaternions, opacities and values, and through the colours
    in the spherical harmonics; first derivatives only.

    Args:
        gaussians: Quaternions of any nonzero length.
        values: float [N, C] or None. Values to composite: colours, ID codes, or other linear
            quantities. None renders colour: the spherical harmonics evaluated for the camera.
        camera: Its principal point may lie anywhere; ``near`` and ``far`` are not used.
        backend: "auto", "cpu", "cuda" or "reference". ``cpu`` is parallel Numba in float32;
            ``cuda`` is gsplat; ``reference`` is plain float64 torch without cut-offs, slow, for
            comparison. ``auto`` takes ``cuda`` for tensors on a GPU, else ``cpu``.
        settings: Settings or "fast", "exact", "3dgs". Image formation and cut-offs; see
            :mod:`slgaussian.rasterize.render_settings`.
        median: Compute the median depth as well.

    Raises:
        InputError: If ``values`` has the wrong shape, a parameter is out of range, NaN or infinite
            (named with its index), or the backend lacks a requested feature.
    """
    settings = find_settings(settings, gaussians.reach(camera))
    if values is None:
        from slgaussian.rasterize.harmonics import compute_colours

        values = compute_colours(gaussians, camera)
    if values.ndim != 2 or values.shape[0] != len(gaussians):
        raise InputError(
            f"rasterize values: found shape {tuple(values.shape)}, expected ({len(gaussians)}, C)"
        )
    if backend == "auto":
        backend = "cuda" if gaussians.means.is_cuda else "cpu"
    draw = resolve("rasterizer", BACKENDS, backend)
    return draw(gaussians, values, gaussians.localize(camera), settings, median)


def check_inputs(gaussians: Gaussians, values: torch.Tensor | np.ndarray) -> None:
    """Raise InputError naming the first invalid number."""
    gaussians.check()
    if (index := first_not_finite(values)) is not None:
        raise InputError(f"rasterize values[{index}]: holds NaN or infinity")
