"""View-dependent colour: real spherical harmonics of degree 0 to 3.

The convention is that of Kerbl et al., "3D Gaussian Splatting", 2023, and of the files that follow
it: ``rgb = max(0, 0.5 + sum_k Y_k(d) sh_k)`` with ``d`` the unit vector from the camera's
centre to the Gaussian's mean, and ``k = l (l + 1) + m`` for degree ``l`` and order ``m = -l .. l``.
The basis is orthonormal on the sphere and keeps the Condon-Shortley phase ``(-1)^m``, so the
degree 1 is ``0.4886 (-y, z, -x)``. Readers and predictors convert to this convention.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import torch

from slgaussian.errors import InputError
from slgaussian.gaussians import SH_C0, Gaussians
from slgaussian.scene import Camera

MAX_DEGREE = 3

COUNTS = tuple((degree + 1) ** 2 for degree in range(MAX_DEGREE + 1))
"""Allowed numbers of coefficients of a colour."""

BANDS = tuple(slice(degree**2, (degree + 1) ** 2) for degree in range(MAX_DEGREE + 1))
"""Slices of the coefficients of each degree."""


def evaluate_sh(directions: torch.Tensor, degree: int) -> torch.Tensor:
    """Evaluate the real spherical harmonics up to ``degree``.

    Args:
        directions: float [3, N]. Unit vectors, a row for each axis, as rows are contiguous. A zero
            vector means no direction and has 0 above degree 0.
        degree: 0 to :data:`MAX_DEGREE`.

    Returns:
        float [(degree + 1)^2, N]
    """
    x, y, z = directions
    rows = [torch.full_like(x, SH_C0)]
    # All polynomials are homogeneous, so that they are 0 at the zero vector.
    if degree >= 1:
        c = math.sqrt(3 / (4 * math.pi))
        rows += [-c * y, c * z, -c * x]
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        c = math.sqrt(15 / (4 * math.pi))
        rows += [
            c * x * y,
            -c * y * z,
            math.sqrt(5 / (16 * math.pi)) * (2 * zz - xx - yy),
            -c * x * z,
            c / 2 * (xx - yy),
        ]
    if degree >= 3:
        c1, c2, c3 = (math.sqrt(n / (32 * math.pi)) for n in (21, 105, 35))
        rows += [
            -c3 * y * (3 * xx - yy),
            2 * math.sqrt(2) * c2 * x * y * z,
            -c1 * y * (4 * zz - xx - yy),
            math.sqrt(7 / (16 * math.pi)) * z * (2 * zz - 3 * xx - 3 * yy),
            -c1 * x * (4 * zz - xx - yy),
            math.sqrt(2) * c2 * z * (xx - yy),
            -c3 * x * (xx - 3 * yy),
        ]
    return torch.stack(rows)


def rotation_matrix(R: np.ndarray) -> np.ndarray:
    """Return the matrix float64 [16, 16] that rotates coefficients by the rotation ``R`` [3, 3].

    The Wigner matrices of degree 0 to 3 of the real basis: ``Y(R d) = D Y(d)`` for every direction.
    Solved on fixed directions, exact to rounding, because rotation maps the harmonics of a degree
    to linear combinations of themselves.
    """
    directions, inverse = _sphere()
    Y = evaluate_sh(torch.from_numpy(R @ directions), MAX_DEGREE).numpy()
    D = np.zeros((len(Y), len(Y)))
    for band in BANDS:
        D[band, band] = Y[band] @ inverse[:, band]
    return D


def compute_colours(gaussians: Gaussians, camera: Camera) -> torch.Tensor:
    """Compute the RGB of every Gaussian from ``camera``, differentiable in ``sh`` and ``means``.

    Args:
        gaussians: With 1, 4, 9 or 16 coefficients a colour.
        camera: Only its centre matters.

    Returns:
        float [N, 3]: In the dtype of ``sh``; 0 or more, possibly above 1. A Gaussian right at the
            camera's centre is seen from no direction: it has its degree-0 colour, and a zero
            gradient in its mean.

    Raises:
        InputError: If there are other numbers of coefficients.
    """
    count = gaussians.sh.shape[1]
    if count not in COUNTS:
        raise InputError(
            f"gaussians sh: found {count} coefficients a colour, expected one of "
            f"{', '.join(map(str, COUNTS))}"
        )
    if count == 1:
        return gaussians.colours().clamp(min=0)
    directions = _directions(gaussians.means, gaussians.localize(camera)).to(gaussians.sh.dtype)
    harmonics = evaluate_sh(directions, math.isqrt(count) - 1)
    return (torch.einsum("kn,nkc->nc", harmonics, gaussians.sh) + 0.5).clamp(min=0)


def _directions(means: torch.Tensor, camera: Camera) -> torch.Tensor:
    """Return unit vectors float64 [3, N] from the camera to ``means``; zero at its centre."""
    # In float64: a million units from the origin, float32 has a resolution of a sixteenth.
    centre = torch.from_numpy(camera.center.copy()).to(means.device)
    offsets = means.double().T.contiguous() - centre[:, None]
    squared = offsets.square().sum(0)
    # Infinity instead of a zero length makes both the quotient and its gradient zero, never NaN.
    return offsets / torch.where(squared > 0, squared, torch.inf).sqrt()


@cache
def _sphere() -> tuple[np.ndarray, np.ndarray]:
    """Return random directions [3, N] and the pseudo-inverse [N, 16] of their basis."""
    directions = np.random.default_rng(0).standard_normal((3, 64))
    directions /= np.linalg.norm(directions, axis=0)
    Y = evaluate_sh(torch.from_numpy(directions), MAX_DEGREE).numpy()
    return directions, np.concatenate([np.linalg.pinv(Y[band]) for band in BANDS], 1)
