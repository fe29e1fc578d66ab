"""The reference rasterizer: float64, every Gaussian at every pixel, for simplicity.

Plain differentiable torch; gradients are those of automatic differentiation.
"""

from typing import Any

import torch

from slgaussian.gaussians import Gaussians, rotation_matrices
from slgaussian.rasterize.api import FRUSTUM_MARGIN, Render, check_inputs
from slgaussian.rasterize.render_settings import Settings
from slgaussian.scene import Camera

PAIRS_AT_ONCE = 4_000_000
"""Pixel-Gaussian pairs in memory at a time (8 bytes each, in a few arrays)."""


def project(
    gaussians: Gaussians, camera: Camera, settings: Settings
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Project to pixel means [N, 2], low-passed covariances [N, 2, 2], opacities [N] and z [N].

    All are float64. Means and covariances at or behind the near plane are undefined.
    """
    double: Any = {name: v.double() for name, v in gaussians.items() if v.is_floating_point()}
    gaussians = Gaussians(**double, source=gaussians.source)
    device = gaussians.means.device
    centre = torch.from_numpy(camera.center).to(device)
    R = torch.from_numpy(camera.c2w[:3, :3].T.copy()).to(device)
    (fx, skew, cx), (_, fy, cy), _ = camera.K.tolist()
    x, y, depth = ((gaussians.means - centre) @ R.T).unbind(-1)
    z = torch.where(depth > settings.near, depth, torch.ones_like(depth))
    x, y = x / z, y / z

    margin_x = FRUSTUM_MARGIN * camera.width / (2 * fx)
    margin_y = FRUSTUM_MARGIN * camera.height / (2 * fy)
    tx = x.clamp(-cx / fx - margin_x, (camera.width - cx) / fx + margin_x)
    ty = y.clamp(-cy / fy - margin_y, (camera.height - cy) / fy + margin_y)
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [
            torch.stack([fx / z, skew / z, -(fx * tx + skew * ty) / z], -1),
            torch.stack([zero, fy / z, -fy * ty / z], -1),
        ],
        -2,
    )
    # Projected axes of each Gaussian: two rows of three.
    axes = jacobian @ R @ rotation_matrices(gaussians.quats) * gaussians.scales[:, None, :]
    cov = axes @ axes.mT + settings.low_pass * torch.eye(2, dtype=torch.float64, device=device)
    return torch.stack([fx * x + skew * y + cx, fy * y + cy], -1), cov, gaussians.opacities, depth


def render(
    gaussians: Gaussians, values: torch.Tensor, camera: Camera, settings: Settings, median: bool
) -> Render:
    """See :func:`slgaussian.rasterize.rasterize`; results are float64, without cut-offs."""
    check_inputs(gaussians, values)
    mean, cov, opacity, z = project(gaussians, camera, settings)
    order = torch.argsort(z.float(), stable=True)
    order = order[z[order] > settings.near]
    mean, z, opacity = mean[order], z[order], opacity[order]
    precision, carried = torch.linalg.inv(cov[order]), values[order].double()

    v, u = torch.meshgrid(
        torch.arange(camera.height) + 0.5, torch.arange(camera.width) + 0.5, indexing="ij"
    )
    pixels = torch.stack([u, v], -1).reshape(-1, 2).to(mean)
    images, alphas, depths, medians = [], [], [], []
    for batch in pixels.split(max(1, PAIRS_AT_ONCE // max(1, len(order)))):
        d = batch[:, None] - mean
        power = -0.5 * torch.einsum("pni,nij,pnj->pn", d, precision, d)
        alpha = (opacity * torch.exp(power)).clamp_max(settings.alpha_max)
        passed = torch.cumprod(1 - alpha, -1)
        before = torch.cat([torch.ones_like(passed[:, :1]), passed[:, :-1]], -1)
        weight = alpha * before
        images.append(weight @ carried)
        alphas.append(weight.sum(-1))
        depths.append(weight @ z)
        if median:
            reached = (passed <= 0.5) & (before > 0.5)
            medians.append((reached * z).sum(-1).detach())
    shape = (camera.height, camera.width)
    total = torch.cat(alphas).reshape(shape)
    depth = torch.cat(depths).reshape(shape) / total.clamp_min(1e-300)
    return Render(
        torch.cat(images).reshape(*shape, -1),
        total,
        depth,
        torch.cat(medians).reshape(shape) if median else None,
    )
