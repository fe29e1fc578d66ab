"""The one call that turns Gaussians into images, and what all backends agree on.

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
from slgaussian.kernels import compiling
from slgaussian.rasterize.render_settings import Settings, find_settings
from slgaussian.scene import Camera

if TYPE_CHECKING:
    import torch

BACKENDS = {
    "cpu": "slgaussian.rasterize.cpu:render",
    "cuda": "slgaussian.rasterize.cuda:render",
    "reference": "slgaussian.rasterize.reference:render",
}

MOST_LABELS = 2**24
"""Labels are compared side by side with their weights, in float32, which is exact below this."""

FRUSTUM_MARGIN = 0.3
"""The affine approximation is evaluated at most this fraction of half the image size outside the
image; further off it explodes (Kerbl et al. 2023 and gsplat take the same fraction)."""


@dataclass(frozen=True, eq=False)
class Render:
    """What a camera sees.

    Attributes
    ----------
    values : float [H, W, C]
        Composited values, premultiplied: divide by ``alpha`` for the mean of what is there.
    alpha : float [H, W]
        Accumulated opacity in [0, 1].
    depth : float [H, W]
        Expected z-depth: the mean over what is there, scene units; 0 where ``alpha`` is 0.
    median : float [H, W] or None
        Median z-depth: of the Gaussian with which ``alpha`` reaches one half; 0 where it does not.
        It carries no gradient.
    label : int32 [H, W] or None
        The label that has most of the pixel's light, 0 where no labelled Gaussian is drawn; it
        carries no gradient.
    label_weights : float [H, W, 3] or None
        How much light that label has, the next one, and all labels together, each in [0, 1].
    """

    values: torch.Tensor
    alpha: torch.Tensor
    depth: torch.Tensor
    median: torch.Tensor | None = None
    label: torch.Tensor | None = None
    label_weights: torch.Tensor | None = None

    __repr__ = short_repr


def rasterize(
    gaussians: Gaussians,
    values: torch.Tensor | None,
    camera: Camera,
    *,
    backend: str = "auto",
    settings: Settings | str = "fast",
    median: bool = False,
    labels: torch.Tensor | None = None,
) -> Render:
    """Render any number of channels of ``gaussians`` as ``camera`` sees them, in one pass.

    Differentiable in the means, scales, quaternions, opacities and values, and through the colours
    in the spherical harmonics; first derivatives only.

    Parameters
    ----------
    gaussians : Gaussians
        Quaternions of any length but zero.
    values : float [N, C] or None
        What each Gaussian carries: colour, ID code, anything linear. None draws their colour: the
        spherical harmonics as seen from the camera.
    camera : Camera
        Its principal point may lie anywhere; ``near`` and ``far`` play no part.
    backend : "auto", "cpu", "cuda" or "reference"
        ``cpu`` is parallel Numba in float32; ``cuda`` is gsplat; ``reference`` is plain float64
        torch that leaves nothing out, slow, for comparison. ``auto`` takes ``cuda`` for tensors
        that are on a GPU, else ``cpu``.
    settings : Settings or "fast", "exact", "3dgs"
        What is drawn and what is cut; see :mod:`slgaussian.rasterize.render_settings`.
    median : bool
        Whether to find the median depth too.
    labels : int32 [N], optional
        What each Gaussian belongs to, below 2^24; 0 is nothing. Finds the label of every pixel: the
        one whose Gaussians have the greatest sum of weights, ties to the lowest.

    Raises
    ------
    InputError
        If ``values`` or ``labels`` has the wrong shape, a label or a parameter is out of its range,
        NaN or infinite (named with its index), or the backend cannot do what is asked.
    """
    compiling.watch()
    settings = find_settings(settings)
    if values is None:
        from slgaussian.rasterize.harmonics import colors

        values = colors(gaussians, camera)
    if values.ndim != 2 or values.shape[0] != len(gaussians):
        raise InputError(
            f"rasterize values: found shape {tuple(values.shape)}, expected ({len(gaussians)}, C)"
        )
    if labels is not None:
        _check_labels(labels, len(gaussians))
    if backend == "auto":
        backend = "cuda" if gaussians.means.is_cuda else "cpu"
    draw = resolve("rasterizer", BACKENDS, backend)
    return draw(gaussians, values, camera, settings, median, labels)


def _check_labels(labels: torch.Tensor, n: int) -> None:
    import torch

    if labels.dtype != torch.int32 or labels.shape != (n,):
        raise InputError(
            f"rasterize labels: found {labels.dtype} {tuple(labels.shape)}, expected int32 ({n},)"
        )
    if n and not 0 <= int(labels.min()) <= int(labels.max()) < MOST_LABELS:
        raise InputError(
            f"rasterize labels: found {int(labels.min())} to {int(labels.max())}, expected 0 to "
            f"{MOST_LABELS - 1}; number them anew from 1"
        )


def check_inputs(gaussians: Gaussians, values: torch.Tensor | np.ndarray) -> None:
    """Raise InputError naming the first number that cannot be drawn."""
    gaussians.check()
    if (index := first_not_finite(values)) is not None:
        raise InputError(f"rasterize values[{index}]: holds NaN or infinity")
