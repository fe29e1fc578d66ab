"""Colour that depends on where it is seen from: real spherical harmonics of degree 0 to 3.

The convention "3dgs" is that of Kerbl et al., "3D Gaussian Splatting", 2023, and of the files that
follow it: ``rgb = max(0, 0.5 + sum_k Y_k(d) sh_k)`` with ``d`` the unit vector from the camera's
centre to the Gaussian's mean, and ``k = l (l + 1) + m`` for degree ``l`` and order ``m = -l .. l``.
The basis is orthonormal on the sphere and keeps the Condon-Shortley phase ``(-1)^m``, so the
degree 1 is ``0.4886 (-y, z, -x)``.

The convention "mvsplat" is what the checkpoints of MVSplat (Chen et al., ECCV 2024) and pixelSplat
(Charatan et al., CVPR 2024) were trained with: the same formula with its axes cycled, ``(x, y, z)``
to ``(z, x, y)``. In the basis of e3nn, in which these models rotate their coefficients, that is the
direction ``(-x, y, -z)``. They predict 25 coefficients a colour and draw with the first 16. The
kernel that they were trained with has ``z`` for ``y`` in one term of degree 3, in its forward pass
alone; here that term is the harmonic, as their masks scale that degree by 0.0016.
"""

from __future__ import annotations

import math

import torch

from slgaussian.errors import InputError
from slgaussian.gaussians import SH_C0, Gaussians
from slgaussian.scene import Camera

MAX_DEGREE = 3

CONVENTIONS = {"3dgs": (1, 4, 9, 16), "mvsplat": (1, 4, 9, 16, 25)}
"""How many coefficients a colour may have in each convention."""


def basis(directions: torch.Tensor, degree: int) -> torch.Tensor:
    """The real spherical harmonics up to ``degree`` in the convention "3dgs".

    Parameters
    ----------
    directions : float [3, N]
        Unit vectors, a row an axis: each is read many times, and rows are contiguous. A zero vector
        stands for no direction and gets 0 for everything above degree 0.
    degree : int
        0 to :data:`MAX_DEGREE`.

    Returns
    -------
    float [(degree + 1)^2, N]
    """
    x, y, z = directions
    rows = [torch.full_like(x, SH_C0)]
    # Every polynomial is homogeneous: without that the zero vector would have a colour.
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


def colors(
    gaussians: Gaussians, camera: Camera, convention: str = "3dgs", degree: int | None = None
) -> torch.Tensor:
    """RGB of every Gaussian as ``camera`` sees it, differentiable in ``sh`` and ``means``.

    Parameters
    ----------
    gaussians : Gaussians
        With 1, 4, 9 or 16 coefficients a colour; in the convention "mvsplat" also 25, of which the
        last nine are not used.
    camera : Camera
        Only its centre matters.
    convention : "3dgs" or "mvsplat"
        See the top of this module.
    degree : int, optional
        Leave out what is above it. All that there is, if not given.

    Returns
    -------
    float [N, 3]
        In the dtype of ``sh``; 0 or more, and above 1 where the harmonics say so. A Gaussian right
        at the camera's centre is seen from no direction: it has its degree-0 colour, and a zero
        gradient in its mean.

    Raises
    ------
    InputError
        If the convention is unknown, the number of coefficients is none of its, or they do not
        reach ``degree``.
    """
    if convention not in CONVENTIONS:
        raise InputError(
            f"harmonics: unknown convention {convention!r}, expected one of "
            f"{', '.join(CONVENTIONS)}"
        )
    count = gaussians.sh.shape[1]
    if count not in CONVENTIONS[convention]:
        expected = ", ".join(map(str, CONVENTIONS[convention]))
        raise InputError(
            f"gaussians sh: found {count} coefficients a colour, expected one of {expected} in the "
            f"convention {convention!r}"
        )
    stored = min(math.isqrt(count) - 1, MAX_DEGREE)
    degree = stored if degree is None else degree
    if degree not in range(stored + 1):
        raise InputError(
            f"harmonics: asked for degree {degree}, expected 0 to {stored} with {count} "
            "coefficients a colour"
        )
    if degree == 0:
        return (gaussians.sh[:, 0] * SH_C0 + 0.5).clamp(min=0)
    directions = _directions(gaussians.means, camera).to(gaussians.sh.dtype)
    if convention == "mvsplat":
        directions = directions.roll(1, 0)
    sh = gaussians.sh[:, : (degree + 1) ** 2]
    return (torch.einsum("kn,nkc->nc", basis(directions, degree), sh) + 0.5).clamp(min=0)


def _directions(means: torch.Tensor, camera: Camera) -> torch.Tensor:
    """Unit vectors float64 [3, N] from the camera to ``means``; zero for a mean at its centre."""
    # In float64: a million units from the origin, float32 keeps the camera to a sixteenth of one.
    centre = torch.from_numpy(camera.center.copy()).to(means.device)
    offsets = means.double().T.contiguous() - centre[:, None]
    squared = offsets.square().sum(0)
    # Infinity where the length is 0 makes both the quotient and its gradient zero, never NaN.
    return offsets / torch.where(squared > 0, squared, torch.inf).sqrt()
