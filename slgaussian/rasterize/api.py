"""The one call that turns Gaussians into images, and what all backends agree on.

A Gaussian is projected by the local affine approximation of perspective (Zwicker et al., "EWA
splatting", 2001), widened by a low-pass filter of :data:`LOW_PASS` px^2, and composited front to
back by the depth of its centre (paper, eq. 2): ``F(v) = sum_i f_i a_i prod_{j<i} (1 - a_j)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians, first_not_finite
from slgaussian.registry import resolve
from slgaussian.scene import Camera

BACKENDS = {
    "cpu": "slgaussian.rasterize.cpu:render",
    "reference": "slgaussian.rasterize.reference:render",
}

LOW_PASS = 0.3
"""Added to the diagonal of every projected covariance, px^2, so that no Gaussian is lost between
pixel centres (Kerbl et al. 2023)."""

NEAR_PLANE = 0.01
"""Gaussians whose centre has z at or below this (scene units) are not drawn."""

FRUSTUM_MARGIN = 0.3
"""The affine approximation is evaluated at most this share of half the field of view outside the
image; further off it explodes (Kerbl et al. 2023 use the same 1.3 times)."""


@dataclass(frozen=True, eq=False)
class Render:
    """What a camera sees.

    Attributes
    ----------
    values : [H, W, C]
        Composited values, premultiplied: divide by ``alpha`` for the mean of what is there.
    alpha : [H, W]
        Accumulated opacity in [0, 1].
    depth : [H, W]
        Mean z-depth of what is there, scene units; 0 where ``alpha`` is 0.
    """

    values: torch.Tensor
    alpha: torch.Tensor
    depth: torch.Tensor


def rasterize(
    gaussians: Gaussians, values: torch.Tensor, camera: Camera, backend: str = "auto"
) -> Render:
    """Render any number of channels of ``gaussians`` as ``camera`` sees them, in one pass.

    Parameters
    ----------
    gaussians : Gaussians
    values : float [N, C]
        What each Gaussian carries: colour, ID code, anything linear.
    camera : Camera
    backend : "auto", "cpu" or "reference"
        ``cpu`` is parallel Numba in float32; ``reference`` is plain float64 torch that leaves
        nothing out, slow, for comparison. ``auto`` takes the fastest there is.

    Raises
    ------
    InputError
        If ``values`` does not have a row a Gaussian, or a parameter is NaN or infinite (named with
        its index).
    """
    if values.ndim != 2 or values.shape[0] != len(gaussians):
        raise InputError(
            f"rasterize values: found shape {tuple(values.shape)}, expected ({len(gaussians)}, C)"
        )
    gaussians.check_finite()
    if (index := first_not_finite(values)) is not None:
        raise InputError(f"rasterize values[{index}]: holds NaN or infinity")
    render = resolve("rasterizer", BACKENDS, "cpu" if backend == "auto" else backend)
    return render(gaussians, values, camera)
