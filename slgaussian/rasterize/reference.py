"""The rasteriser written to be obviously right: float64, every Gaussian at every pixel."""

import torch

from slgaussian.gaussians import Gaussians, covariances
from slgaussian.rasterize.api import FRUSTUM_MARGIN, LOW_PASS, NEAR_PLANE, Render
from slgaussian.scene import Camera

PAIRS_AT_ONCE = 4_000_000
"""Pixel-Gaussian pairs in memory at a time (8 bytes each, a few arrays of them)."""


def project(
    gaussians: Gaussians, camera: Camera
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Pixel means [N, 2], pixel covariances [N, 2, 2] (low-passed) and depths z [N], float64."""
    double = Gaussians(**{name: v.double() for name, v in gaussians.items() if name != "source"},
                       source=gaussians.source)  # fmt: skip
    w2c = torch.from_numpy(camera.w2c)
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    skew = camera.K[0, 1]
    local = double.means @ w2c[:3, :3].T + w2c[:3, 3]
    x, y, z = local.unbind(-1)
    z = torch.where(z > NEAR_PLANE, z, torch.ones_like(z))
    u = fx * x / z + skew * y / z + cx
    v = fy * y / z + cy

    margin_x = FRUSTUM_MARGIN * camera.width / (2 * fx)
    margin_y = FRUSTUM_MARGIN * camera.height / (2 * fy)
    tx = (x / z).clamp(-cx / fx - margin_x, (camera.width - cx) / fx + margin_x)
    ty = (y / z).clamp(-cy / fy - margin_y, (camera.height - cy) / fy + margin_y)
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [
            torch.stack([fx / z, skew / z, -(fx * tx + skew * ty) / z], -1),
            torch.stack([zero, fy / z, -fy * ty / z], -1),
        ],
        -2,
    )
    to_pixels = jacobian @ w2c[:3, :3]
    cov = to_pixels @ covariances(double) @ to_pixels.mT + LOW_PASS * torch.eye(2)
    return torch.stack([u, v], -1), cov, local[:, 2]


def render(gaussians: Gaussians, values: torch.Tensor, camera: Camera) -> Render:
    """See :func:`slgaussian.rasterize.rasterize`; results are float64."""
    mean, cov, z = project(gaussians, camera)
    order = torch.argsort(z, stable=True)
    order = order[z[order] > NEAR_PLANE]
    mean, z, precision = mean[order], z[order], torch.linalg.inv(cov[order])
    opacity, carried = gaussians.opacities[order].double(), values[order].double()

    v, u = torch.meshgrid(
        torch.arange(camera.height) + 0.5, torch.arange(camera.width) + 0.5, indexing="ij"
    )
    pixels = torch.stack([u, v], -1).reshape(-1, 2).double()
    colours, alphas, depths = [], [], []
    for some in pixels.split(max(1, PAIRS_AT_ONCE // max(1, len(order)))):
        d = some[:, None] - mean
        power = -0.5 * torch.einsum("pni,nij,pnj->pn", d, precision, d)
        alpha = opacity * torch.exp(power)
        passed = torch.cumprod(1 - alpha, -1)
        before = torch.cat([torch.ones_like(passed[:, :1]), passed[:, :-1]], -1)
        weight = alpha * before
        colours.append(weight @ carried)
        alphas.append(weight.sum(-1))
        depths.append(weight @ z)
    shape = (camera.height, camera.width)
    total = torch.cat(alphas).reshape(shape)
    depth = torch.cat(depths).reshape(shape) / total.clamp_min(1e-300)
    return Render(torch.cat(colours).reshape(*shape, -1), total, depth)
