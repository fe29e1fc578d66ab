"""From the network's numbers at every pixel to Gaussians in the world."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from slgaussian import harmonics
from slgaussian.predict.mvsplat.config import Config
from slgaussian.predict.mvsplat.depth import POSE_CHANNELS
from slgaussian.scene import Camera


def lift(
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
    """Coefficients [N, K, 3] in the world of [N, K * 3] in the camera's frame, damped by degree."""
    rotation = rotate_harmonics(camera.c2w[:3, :3])
    rotation *= np.array([damping(math.isqrt(k)) for k in range(len(rotation))])
    # All three colours in one product.
    whole = torch.from_numpy(np.kron(rotation, np.eye(3))).to(sh)
    return (sh @ whole.T).view(len(sh), -1, 3)


def damping(degree: int) -> float:
    """Factor on predicted coefficients: in training, higher degrees start out smaller."""
    return 1.0 if degree == 0 else 0.1 * 0.25**degree


def rotate_harmonics(R: np.ndarray) -> np.ndarray:
    """Matrix float64 [16, 16] that turns coefficients as ``R`` turns the scene.

    The real Wigner matrices of degree 0 to 3 in the basis and order of e3nn, in which the networks
    were trained: ``Y(R d) = D Y(d)`` for any direction. It is solved for on fixed directions,
    exact to rounding as the harmonics of a degree are turned into themselves.
    """
    directions, inverse = _sphere()
    turned = e3nn_basis(R @ directions)
    D = np.zeros((len(turned), len(turned)))
    for degree in range(harmonics.MAX_DEGREE + 1):
        band = slice(degree**2, (degree + 1) ** 2)
        D[band, band] = turned[band] @ inverse[:, band]
    return D


def e3nn_basis(directions: np.ndarray) -> np.ndarray:
    """Real harmonics [16, N] of unit vectors [3, N] in the convention of e3nn.

    That is the convention "mvsplat" of :mod:`slgaussian.harmonics` seen from (-x, y, -z).
    """
    x, y, z = directions
    rolled = torch.from_numpy(np.stack([-z, -x, y]))
    return harmonics.basis(rolled, harmonics.MAX_DEGREE).numpy()


@cache
def _sphere() -> tuple[np.ndarray, np.ndarray]:
    """Directions [3, N] in no special position, and the pseudo-inverse [N, 16] of their basis."""
    directions = np.random.default_rng(0).standard_normal((3, 64))
    directions /= np.linalg.norm(directions, axis=0)
    basis = e3nn_basis(directions)
    inverse = np.zeros(basis.T.shape)
    for degree in range(harmonics.MAX_DEGREE + 1):
        band = slice(degree**2, (degree + 1) ** 2)
        inverse[:, band] = np.linalg.pinv(basis[band])
    return directions, inverse
