"""The CUDA rasterizer: gsplat (Ye et al., JMLR 2025, https://docs.gsplat.studio, Apache-2.0).

This module imports gsplat on use. Its kernels have fixed constants, so images differ from those of
the other backends and from the settings as follows:

- Alphas are clamped to 0.999, whatever ``alpha_max`` is.
- A Gaussian is cut where its alpha is below 1/255 and outside of a rectangle of at most 3.33
  standard deviations, whatever ``alpha_min`` and ``sigmas`` are.
- A pixel is finished before the Gaussian that would reduce its transmittance to at most 1e-4,
  whatever ``pass_min`` is.
- A Gaussian whose z is exactly ``near`` is drawn.
- The arithmetic is float32, without IEEE rounding of divisions.
"""

from __future__ import annotations

from collections.abc import Callable

import torch

from slgaussian.errors import InputError
from slgaussian.extras import install_line
from slgaussian.gaussians import Gaussians
from slgaussian.rasterize.api import Render, check_inputs
from slgaussian.rasterize.render_settings import Settings
from slgaussian.scene import Camera

MIN_ALPHA_MAX = 0.99
"""Smallest accepted ``alpha_max``, the constant of Kerbl et al. 2023, within 0.01 of gsplat's own
0.999. A stronger clamp would be visible and is refused."""


def render(
    gaussians: Gaussians, values: torch.Tensor, camera: Camera, settings: Settings, median: bool
) -> Render:
    """See :func:`slgaussian.rasterize.rasterize`; results are float32, on the device of the input.

    ``near``, ``low_pass`` and any number of channels are supported; the module lists differences.

    Raises:
        InputError: If the tensors are not on one CUDA device, gsplat is not installed or has no
            compiled kernels, or it does not support the request: the median depth, pixels with
            skew, or an ``alpha_max`` below :data:`MIN_ALPHA_MAX`.
    """
    _check_possible(camera, settings, median)
    device = _one_device(gaussians, values)
    rasterization = load_gsplat()
    if not _all_valid(gaussians, values):
        check_inputs(gaussians, values)  # names the first invalid number
    size = camera.height, camera.width
    if len(gaussians) == 0:  # gsplat 1.5 would end the process by a division by zero
        empty = torch.zeros(size, device=device)
        return Render(values.new_zeros(*size, values.shape[1]).float(), empty, empty.clone())

    # Relative to the camera in float64: a million units from the origin, float32 has a resolution
    # of a sixteenth. Quaternions of any length are normalised in float64 too.
    R = torch.from_numpy(camera.c2w[:3, :3].T.copy()).to(device)
    offsets = gaussians.means.double() - torch.from_numpy(camera.center.copy()).to(device)
    quats = gaussians.quats.double()
    world_to_camera = torch.eye(4, device=device)
    world_to_camera[:3, :3] = R
    # Depth is an additional channel, so that there is at least one, as gsplat requires.
    carried = torch.cat([values.float(), (offsets @ R[2]).float()[:, None]], 1)
    image, alpha, _ = rasterization(
        means=offsets.float(),
        quats=(quats / quats.norm(dim=-1, keepdim=True)).float(),
        scales=gaussians.scales.float(),
        opacities=gaussians.opacities.float(),
        colors=carried,
        viewmats=world_to_camera[None],
        Ks=torch.from_numpy(camera.K).float().to(device)[None],
        width=camera.width,
        height=camera.height,
        near_plane=settings.near,
        far_plane=torch.finfo(torch.float32).max,  # at infinity: a camera's ``far`` is not used
        eps2d=settings.low_pass,
        packed=False,
    )
    image, alpha = image[0], alpha[0, ..., 0]
    # Alpha is 0 or at least 1/255, so the clamp introduces no bias.
    depth = image[..., -1] / alpha.clamp_min(1e-10)
    return Render(image[..., :-1], alpha, depth)


def _check_possible(camera: Camera, settings: Settings, median: bool) -> None:
    instead = "use backend 'cpu' for it"
    if median:
        raise InputError(f"rasterize: gsplat (backend 'cuda') finds no median depth; {instead}")
    if camera.K[0, 1] != 0:
        raise InputError(
            f"camera K: found a skew of {camera.K[0, 1]:g} px, expected 0, as gsplat (backend "
            f"'cuda') has no skew; {instead}"
        )
    if settings.alpha_max < MIN_ALPHA_MAX:
        raise InputError(
            f"rasterize settings alpha_max: found {settings.alpha_max}, expected "
            f"{MIN_ALPHA_MAX} or more, as gsplat (backend 'cuda') clamps to 0.999; {instead}"
        )


def _one_device(gaussians: Gaussians, values: torch.Tensor) -> torch.device:
    fields = ("means", "scales", "quats", "opacities")
    drawn = {f"gaussians {name}": getattr(gaussians, name) for name in fields}
    drawn["rasterize values"] = values
    device = gaussians.means.device
    for name, value in drawn.items():
        if not value.is_cuda or value.device != device:
            raise InputError(
                f"{name}: found on device {str(value.device)!r}, expected all tensors on one CUDA "
                "device for backend 'cuda'; move them there, or use backend 'cpu'"
            )
    return device


def _all_valid(gaussians: Gaussians, values: torch.Tensor) -> bool:
    """Return whether :func:`check_inputs` would pass, by one transfer from the GPU."""
    numbers = [value for _, value in gaussians.items()] + [values]
    conditions = [
        *(torch.isfinite(value).all() for value in numbers),
        (gaussians.scales >= 0).all(),
        ((gaussians.opacities >= 0) & (gaussians.opacities <= 1)).all(),
        (gaussians.quats != 0).any(1).all(),
    ]
    return bool(torch.stack(conditions).all())


def load_gsplat() -> Callable:
    """Import gsplat's ``rasterization``; raises InputError if it or its kernels are missing."""
    try:
        from gsplat import rasterization
        from gsplat.cuda._backend import _C as kernels
    except ImportError as error:
        raise InputError(
            f"rasterize backend 'cuda': cannot import gsplat ({error}); install it with "
            f"{install_line('cuda')}, or use backend 'cpu'"
        ) from error
    if kernels is None:
        raise InputError(
            "rasterize backend 'cuda': gsplat found neither compiled kernels nor a CUDA toolkit to "
            "compile them with; install nvcc or one of gsplat's compiled wheels "
            "(https://docs.gsplat.studio), or use backend 'cpu'"
        )
    return rasterization
