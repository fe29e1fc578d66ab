"""Gaussians: one structure of arrays, the geometry and colour of a scene.

Spherical harmonics follow the standard 3D Gaussian splatting convention (Kerbl et al. 2023):
``rgb = 0.5 + sum_k Y_k(d) sh_k``, so a degree-0 coefficient is ``(rgb - 0.5) / SH_C0``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from scipy.ndimage import minimum_filter

from slgaussian.errors import InputError
from slgaussian.formats.brief import brief
from slgaussian.scene import Camera

SH_C0 = 0.28209479177387814
"""Value of the constant spherical harmonic, 1 / (2 sqrt(pi))."""


@dataclass(frozen=True, eq=False)
class Gaussians:
    """N anisotropic Gaussians in world space.

    Attributes
    ----------
    means : float32 [N, 3]
        Centres, scene units.
    scales : float32 [N, 3]
        Standard deviations along the local axes, scene units, positive.
    quats : float32 [N, 4]
        Rotations local-to-world, wxyz; of unit length, though any but zero is taken.
    opacities : float32 [N]
        In [0, 1].
    sh : float32 [N, K, 3]
        Spherical-harmonic colour, K = (degree + 1)^2.
    source : int32 [N]
        Flat index ``(view * H + row) * W + column`` of the context pixel each Gaussian came from.
    features : float32 [N, D] or None
        Semantic features. In a field: the ID code (3 numbers in the paper) times its weight, and
        the weight; see :class:`slgaussian.semantic.Lifting`.
    guessed : bool [N] or None
        Whose depth no second view confirms: continued from what lies beside it. None where the
        predictor does not tell.

    Raises
    ------
    InputError
        If shapes disagree; :meth:`check` looks at the numbers.
    """

    means: torch.Tensor
    scales: torch.Tensor
    quats: torch.Tensor
    opacities: torch.Tensor
    sh: torch.Tensor
    source: torch.Tensor
    features: torch.Tensor | None = None
    guessed: torch.Tensor | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        n = self.means.shape[0]
        tails = {"means": (3,), "scales": (3,), "quats": (4,), "opacities": (), "source": ()}
        for name, tail in tails.items():
            shape = tuple(getattr(self, name).shape)
            if shape != (n, *tail):
                raise InputError(f"gaussians {name}: found shape {shape}, expected {(n, *tail)}")
        if self.sh.ndim != 3 or self.sh.shape[0] != n or self.sh.shape[2] != 3:
            raise InputError(f"gaussians sh: found {tuple(self.sh.shape)}, expected ({n}, K, 3)")
        if self.features is not None and self.features.shape[0] != n:
            raise InputError(f"gaussians features: {self.features.shape[0]} rows, expected {n}")
        if self.guessed is not None and self.guessed.shape != (n,):
            raise InputError(
                f"gaussians guessed: found shape {tuple(self.guessed.shape)}, expected ({n},)"
            )

    def __len__(self) -> int:
        return self.means.shape[0]

    def __getitem__(self, keep: torch.Tensor) -> Gaussians:
        """The Gaussians chosen by a boolean mask [N] or an index tensor."""
        return replace(self, **{name: value[keep] for name, value in self.items()})

    def items(self) -> list[tuple[str, torch.Tensor]]:
        """The (name, tensor) pairs that are present."""
        pairs = ((f.name, getattr(self, f.name)) for f in fields(self))
        return [(name, value) for name, value in pairs if value is not None]

    def require_features(self) -> torch.Tensor:
        """The features, float32 [N, D]; InputError if there are none."""
        if self.features is None:
            raise InputError("gaussians features: found none, expected some in a semantic field")
        return self.features

    def check(self) -> None:
        """Raise :class:`InputError` naming the first field and index whose numbers make no sense.

        That is NaN or infinity anywhere, a negative scale, an opacity outside [0, 1] or a
        quaternion of length zero.
        """
        for name, value in self.items():
            if (index := first_not_finite(value)) is not None:
                raise InputError(f"gaussians {name}[{index}]: holds NaN or infinity")
        rules = {
            "scales": ((self.scales < 0).any(1), "expected 0 or more"),
            "opacities": ((self.opacities < 0) | (self.opacities > 1), "expected 0 to 1"),
            "quats": ((self.quats == 0).all(1), "a quaternion of length zero is no rotation"),
        }
        for name, (bad, expected) in rules.items():
            if bad.any():
                index = int(bad.nonzero()[0, 0])
                found = getattr(self, name)[index].tolist()
                raise InputError(f"gaussians {name}[{index}]: found {found}, {expected}")

    def colors(self) -> torch.Tensor:
        """View-independent RGB, float [N, 3]: the degree-0 part of ``sh``."""
        return self.sh[:, 0] * SH_C0 + 0.5

    def to_arrays(self) -> dict[str, np.ndarray]:
        """NumPy arrays by field name, as stored in ``gaussians.npz``."""
        return {name: value.detach().cpu().numpy() for name, value in self.items()}

    @staticmethod
    def from_arrays(arrays: dict[str, np.ndarray]) -> Gaussians:
        """Inverse of :meth:`to_arrays`."""
        return Gaussians(**{name: torch.from_numpy(np.array(a)) for name, a in arrays.items()})


def first_not_finite(values: torch.Tensor) -> int | None:
    """Index of the first row that holds NaN or infinity, or None."""
    # In NumPy: a check is a fraction of a millisecond, less than torch needs to wake its threads.
    finite = np.isfinite(values.detach().cpu().numpy())
    if finite.all():
        return None
    return int(np.argwhere(~finite)[0, 0])


def rgb_to_sh(rgb: torch.Tensor) -> torch.Tensor:
    """Degree-0 coefficients [N, 1, 3] of view-independent colours [N, 3] in [0, 1]."""
    return ((rgb - 0.5) / SH_C0)[:, None]


def rotation_matrices(quats: torch.Tensor) -> torch.Tensor:
    """Rotation matrices [N, 3, 3] of quaternions wxyz [N, 4], normalised here."""
    w, x, y, z = (quats / quats.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, -1).reshape(*quats.shape[:-1], 3, 3)


def covariances(gaussians: Gaussians) -> torch.Tensor:
    """World-space covariance R S S^T R^T of each Gaussian, [N, 3, 3]."""
    factor = rotation_matrices(gaussians.quats) * gaussians.scales[:, None, :]
    return factor @ factor.mT


def source_depths(gaussians: Gaussians, cameras: Sequence[Camera]) -> np.ndarray:
    """Depth maps of the context views, from the Gaussian that each pixel gave birth to.

    A pixel without one, because other views draw its surface already, has the depth of the nearest
    of their Gaussians that lands on it or beside it.

    Parameters
    ----------
    gaussians : Gaussians
    cameras : sequence of V Camera
        The context cameras, in order, all of one size.

    Returns
    -------
    float32 [V, H, W]
        z-depth in scene units; 0 where nothing is drawn, and in views that draw nothing (left).
    """
    H, W = cameras[0].height, cameras[0].width
    depths = np.zeros((len(cameras), H * W), np.float32)
    source = gaussians.source.numpy()
    means = gaussians.means.numpy().astype(np.float64)
    for index, (camera, depth) in enumerate(zip(cameras, depths, strict=True)):
        mine = source // (H * W) == index
        pixels, z = camera.project(means)
        depth[source[mine] % (H * W)] = z[mine]
        if not mine.any() or (depth > 0).all():
            continue
        landed = np.full((H, W), np.inf, np.float32)
        inside = ~mine & (z > 0) & (pixels >= 0).all(1) & (pixels < (W, H)).all(1)
        column, row = pixels[inside].astype(np.int64).T
        np.minimum.at(landed, (row, column), z[inside].astype(np.float32))
        # Points do not land on every pixel.
        beside = minimum_filter(landed, 3)
        lent = np.where(np.isfinite(landed), landed, beside).ravel()
        depth[:] = np.where((depth == 0) & np.isfinite(lent), lent, depth)
    return depths.reshape(len(cameras), H, W)
