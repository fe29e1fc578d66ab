"""Conversion of the network's output at every pixel to Gaussians in the world."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from slgaussian.predict.mvsplat.depth import PARAMETERS
from slgaussian.rasterize import harmonics
from slgaussian.scene import Camera

MIN_SCALE, MAX_SCALE = 0.5, 15.0
"""Range of a Gaussian's standard deviation, in tenths of a pixel at its depth."""

DAMPING = 1.0, 0.025, 0.00625, 0.0015625
"""Factors on the coefficients of degree 0 to 3, from the training initialisation."""

HALF_TURN = np.diag([-1.0, 1.0, -1.0])
"""Half turn about y, from which the networks evaluate the harmonics."""

CYCLE = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
"""From (x, y, z) to (z, x, y), the axes of the rendering formula."""


def make_gaussians(
    disparity: torch.Tensor, raw: torch.Tensor, camera: Camera
) -> dict[str, torch.Tensor]:
    """Compute the Gaussians of one view, one for each pixel in row-major order.

    Args:
        disparity: float32 [H, W]
        raw: float [H, W, 57]. As in :class:`slgaussian.predict.mvsplat.depth.Pixelwise`.
        camera: Of size (H, W).

    Returns:
        dict: ``means`` [N, 3], ``scales`` [N, 3], ``quats`` [N, 4] and ``sh`` [N, 16, 3] of
            :class:`slgaussian.gaussians.Gaussians`, float32.
    """
    depth = disparity.reciprocal().view(-1, 1)
    offset, scale, quat, sh = raw.flatten(0, 1).float().split(PARAMETERS, 1)
    pixel = 0.1 * (1 / camera.K[0, 0] + 1 / camera.K[1, 1])
    size = MIN_SCALE + (MAX_SCALE - MIN_SCALE) * scale.sigmoid()
    to_world = torch.from_numpy(harmonics_to_world(camera.c2w[:3, :3])).to(sh)
    return {
        "means": _means(offset, depth, camera),
        "scales": size * (depth * pixel),
        "quats": _quats(quat, camera),
        "sh": (sh.view(len(sh), 3, -1) @ to_world.T).mT,
    }


def _means(offset: torch.Tensor, depth: torch.Tensor, camera: Camera) -> torch.Tensor:
    """Return means up to half a pixel from the pixel centre, at ``depth`` along the ray.

    Z-depth is used as a distance, as in the training of the checkpoints.
    """
    H, W = camera.height, camera.width
    corner = torch.cartesian_prod(*(torch.arange(n, device=depth.device) for n in (H, W))).flip(1)
    # Centre at half a pixel plus (sigmoid - 0.5) is the sigmoid from the pixel's corner.
    pixels = corner + offset.sigmoid()
    to_world = torch.from_numpy(camera.c2w[:3, :3] @ np.linalg.inv(camera.K)).to(pixels)
    rays = torch.addmm(to_world[:, 2], pixels, to_world[:, :2].T)
    rays *= depth / rays.norm(dim=1, keepdim=True)
    return rays.add_(torch.from_numpy(camera.center.copy()).to(rays))


def _quats(xyzw: torch.Tensor, camera: Camera) -> torch.Tensor:
    """Convert quaternions xyzw in the camera frame to unit quaternions wxyz in the world."""
    x, y, z, w = Rotation.from_matrix(camera.c2w[:3, :3]).as_quat().tolist()
    # Multiplication by the camera's quaternion from the left, xyzw in and wxyz out.
    product = xyzw.new_tensor([[-x, -y, -z, w], [w, -z, y, x], [z, w, -x, y], [-y, x, w, z]])
    # Artificial weights may predict a zero quaternion, which is no rotation.
    return torch.nn.functional.normalize(xyzw @ product.T, eps=1e-8)


def harmonics_to_world(R: np.ndarray) -> np.ndarray:
    """Return the matrix float64 [16, 16] from predicted coefficients to those in the world.

    The networks predict coefficients ``c`` in the basis ``E`` of e3nn, whose polar axis is y: the
    colour in direction ``d`` is ``E(H d) . D m c``, with the damping ``m``, the Wigner matrix ``D``
    of the camera's rotation ``R`` and the half turn ``H``. With ``E(d) = Y(C H d)``, where ``Y`` is
    the basis of :mod:`slgaussian.rasterize.harmonics` and ``C`` the cycle of axes, this equals
    ``Y(d) . T m c``, where ``T`` is the rotation ``H R H C^-1``. Of 25 coefficients 16 are
    rendered. The CUDA kernel of the training has ``z`` for ``y`` in one term of degree 3, in its
    forward pass only; here that term is the correct harmonic.
    """
    turn = harmonics.rotation_matrix(HALF_TURN @ R @ HALF_TURN @ CYCLE.T)
    for factor, band in zip(DAMPING, harmonics.BANDS, strict=True):
        turn[:, band] *= factor
    return turn
