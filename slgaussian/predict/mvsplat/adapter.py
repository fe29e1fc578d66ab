"""Conversion of the network's output at every pixel to Gaussians in the world.

**Colour.** :func:`harmonics_to_world` converts the networks' convention of spherical harmonics to
that of :mod:`slgaussian.rasterize.harmonics`. The networks predict coefficients in the basis of
e3nn, whose polar axis is y, and rotate them into the world in that basis. They render with the
formula of Kerbl et al. with cycled axes, which is e3nn's basis seen from ``(-x, y, -z)``. That is a
rotation as well, so one rotation of the coefficients is enough. Of 25 predicted coefficients for
each colour 16 are rendered. The CUDA kernel of the training has ``z`` for ``y`` in one term of
degree 3, in its forward pass only; here that term is the correct harmonic, as the degree is damped
to 0.0016."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from slgaussian.predict.mvsplat.config import Config
from slgaussian.predict.mvsplat.depth import POSE_CHANNELS
from slgaussian.rasterize import harmonics
from slgaussian.scene import Camera

HALF_TURN = np.diag([-1.0, 1.0, -1.0])
"""Half turn about y, from which the networks evaluate the harmonics."""

CYCLE = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
"""From (x, y, z) to (z, x, y), the axes of the rendering formula."""


def gaussians_of(
    disparity: torch.Tensor, raw: torch.Tensor, camera: Camera, config: Config
) -> dict[str, torch.Tensor]:
    """Compute the Gaussians of one view, one for each pixel in row-major order.

    Args:
        disparity: float32 [H, W]
        raw: float [H, W, 9 + 3 K]. As in :class:`slgaussian.predict.mvsplat.depth.Pixelwise`.
        camera: Of size (H, W).

    Returns:
        dict: ``means`` [N, 3], ``scales`` [N, 3], ``quats`` [N, 4] and ``sh`` [N, K, 3] of
            :class:`slgaussian.gaussians.Gaussians`, float32.
    """
    raw = raw.flatten(0, 1).float()
    depth = disparity.reciprocal().view(-1, 1)
    offset, scale, quat, sh = raw.split((2, 3, 4, raw.shape[1] - POSE_CHANNELS), 1)
    return {
        "means": _means(offset, depth, camera),
        "scales": _scales(scale, depth, camera, config),
        "quats": _quats(quat, camera),
        "sh": _harmonics(sh, camera),
    }


def _means(offset: torch.Tensor, depth: torch.Tensor, camera: Camera) -> torch.Tensor:
    """Return means up to half a pixel from the pixel centre, at ``depth`` along the ray.

    Z-depth is used as a distance, as in the training of the checkpoints.
    """
    H, W = camera.height, camera.width
    row, column = torch.meshgrid(
        torch.arange(H, device=depth.device), torch.arange(W, device=depth.device), indexing="ij"
    )
    # Centre at half a pixel plus (sigmoid - 0.5) is the sigmoid from the pixel's corner.
    pixels = torch.stack([column.ravel(), row.ravel()], 1) + offset.sigmoid()
    to_world = torch.from_numpy(camera.c2w[:3, :3] @ np.linalg.inv(camera.K)).to(pixels)
    rays = torch.addmm(to_world[:, 2], pixels, to_world[:, :2].T)
    rays *= depth / rays.norm(dim=1, keepdim=True)
    return rays.add_(torch.from_numpy(camera.center.copy()).to(rays))


def _scales(
    scale: torch.Tensor, depth: torch.Tensor, camera: Camera, config: Config
) -> torch.Tensor:
    low, high = config.scale_min, config.scale_max
    pixel = 0.1 * (1 / camera.K[0, 0] + 1 / camera.K[1, 1])
    return (low + (high - low) * scale.sigmoid()) * (depth * pixel)


def _quats(xyzw: torch.Tensor, camera: Camera) -> torch.Tensor:
    """Convert quaternions xyzw in the camera frame to unit quaternions wxyz in the world."""
    turn = Rotation.from_matrix(camera.c2w[:3, :3]).as_quat()
    x, y, z, w = (float(part) for part in turn)
    # Multiplication by the camera's quaternion from the left, xyzw in and wxyz out.
    product = xyzw.new_tensor(
        [
            [-x, -y, -z, w],
            [w, -z, y, x],
            [z, w, -x, y],
            [-y, x, w, z],
        ]
    )
    quats = xyzw @ product.T
    # Artificial weights may predict a zero quaternion, which is no rotation.
    return torch.nn.functional.normalize(quats, eps=1e-8)


def _harmonics(sh: torch.Tensor, camera: Camera) -> torch.Tensor:
    """Convert predicted coefficients [N, 16 * 3], colours fastest, to the world, [N, 16, 3]."""
    # All three colours in one product.
    matrix = torch.from_numpy(np.kron(harmonics_to_world(camera.c2w[:3, :3]), np.eye(3))).to(sh)
    return (sh @ matrix.T).view(len(sh), -1, 3)


def harmonics_to_world(R: np.ndarray) -> np.ndarray:
    """Return the matrix float64 [16, 16] from predicted coefficients to those in the world.

    The networks define the colour in direction ``d`` as ``E(H d) . D m c``: coefficients ``c``,
    damped by ``m``, are rotated by the Wigner matrix ``D`` of the camera's rotation ``R``, and
    e3nn's basis ``E`` is evaluated after the half turn ``H``. With ``E(d) = Y(C H d)``, where ``Y``
    is the basis of :mod:`slgaussian.rasterize.harmonics` and ``C`` the cycle of axes, this equals
    ``Y(d) . T m c``, where ``T`` is the rotation ``H R H C^-1``."""
    turn = harmonics.rotation_matrix(HALF_TURN @ R @ HALF_TURN @ CYCLE.T)
    for degree, band in enumerate(harmonics.BANDS):
        turn[:, band] *= damping(degree)
    return turn


def damping(degree: int) -> float:
    """Return the factor on predicted coefficients of a degree, from the training initialisation."""
    return 1.0 if degree == 0 else 0.1 * 0.25**degree
