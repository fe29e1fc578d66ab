"""From the network's numbers at every pixel to Gaussians in the world.

**Colour.** The networks were trained with harmonics of their own, which end here:
:func:`harmonics_to_world` brings them to those of :mod:`slgaussian.rasterize.harmonics`. They
predict in the basis of e3nn, whose polar axis is y, and turn into the world there. Then they draw
with the formula of Kerbl et al. with its axes cycled, which is e3nn's basis seen from ``(-x, y,
-z)``: that, too, is a rotation, so one rotation of the coefficients does all. They predict 25
coefficients a colour and draw 16 of them. The kernel that they were trained with has ``z`` for
``y`` in one term of degree 3, in its forward pass alone; here that term is the harmonic, as that
degree is damped to 0.0016."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from slgaussian.predict.mvsplat.config import Config
from slgaussian.predict.mvsplat.depth import POSE_CHANNELS
from slgaussian.rasterize import harmonics
from slgaussian.scene import Camera

HALF_TURN = np.diag([-1.0, 1.0, -1.0])
"""About y: from where the networks see the harmonics."""

CYCLE = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
"""From (x, y, z) to (z, x, y): the axes of the formula that they draw with."""


def gaussians_of(
    disparity: torch.Tensor, raw: torch.Tensor, camera: Camera, config: Config
) -> dict[str, torch.Tensor]:
    """The Gaussians of one view, one a pixel in the order of its rows.

    Parameters
    ----------
    disparity : float32 [H, W]
    raw : float [H, W, 9 + 3 K]
        As in :class:`slgaussian.predict.mvsplat.depth.Pixelwise`.
    camera : Camera
        Of size (H, W).
    config : Config

    Returns
    -------
    dict
        ``means`` [N, 3], ``scales`` [N, 3], ``quats`` [N, 4] and ``sh`` [N, K, 3] of
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
    """Up to half a pixel from the pixel's centre, at ``depth`` along the ray.

    The depth was found along z and is taken for a distance: so the checkpoints were trained.
    """
    H, W = camera.height, camera.width
    row, column = torch.meshgrid(
        torch.arange(H, device=depth.device), torch.arange(W, device=depth.device), indexing="ij"
    )
    # Half a pixel, and the sigmoid less a half: the sigmoid from the pixel's corner.
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
    """Unit quaternions wxyz in the world of xyzw in the camera's frame."""
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
    # A quaternion of zeros, which only weights made by hand give, is no rotation of any kind.
    return torch.nn.functional.normalize(quats, eps=1e-8)


def _harmonics(sh: torch.Tensor, camera: Camera) -> torch.Tensor:
    """Coefficients [N, 16, 3] in the world of predicted ones [N, 16 * 3], colours the fastest."""
    # All three colours in one product.
    whole = torch.from_numpy(np.kron(harmonics_to_world(camera.c2w[:3, :3]), np.eye(3))).to(sh)
    return (sh @ whole.T).view(len(sh), -1, 3)


def harmonics_to_world(R: np.ndarray) -> np.ndarray:
    """Matrix float64 [16, 16] from what the networks predict to coefficients in the world.

    They say ``E(H d) . D m c`` of the colour in direction ``d``: coefficients ``c``, damped by
    ``m``, are turned by the Wigner matrix ``D`` of the camera's rotation ``R``, and e3nn's basis
    ``E`` is seen after the half turn ``H``. With ``E(d) = Y(C H d)``, where ``Y`` is the basis of
    :mod:`slgaussian.rasterize.harmonics` and ``C`` the cycle of axes, that is ``Y(d) . T m c``,
    where ``T`` turns as ``H R H C^-1`` does."""
    turn = harmonics.turned(HALF_TURN @ R @ HALF_TURN @ CYCLE.T)
    for degree, band in enumerate(harmonics.BANDS):
        turn[:, band] *= damping(degree)
    return turn


def damping(degree: int) -> float:
    """Factor on predicted coefficients: in training, higher degrees start out smaller."""
    return 1.0 if degree == 0 else 0.1 * 0.25**degree
