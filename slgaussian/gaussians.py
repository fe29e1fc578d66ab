"""Gaussians: geometry and colour of a scene, as a structure of arrays.

Spherical harmonics follow the standard 3D Gaussian splatting convention (Kerbl et al. 2023):
``rgb = 0.5 + sum_k Y_k(d) sh_k``, so a degree-0 coefficient is ``(rgb - 0.5) / SH_C0``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Generic, TypeVar, overload

import numpy as np

from slgaussian.errors import InputError
from slgaussian.io import short_repr
from slgaussian.scene import Camera, Frame

if TYPE_CHECKING:  # queries and rendering on the CPU must not import torch, which takes a second
    import torch

Held = TypeVar("Held")
Numbers = TypeVar("Numbers", "torch.Tensor", "np.ndarray")

SH_C0 = 0.28209479177387814
"""Value of the constant spherical harmonic, 1 / (2 sqrt(pi))."""


class _Tensor(Generic[Held]):
    """A tensor field of :class:`Gaussians`, converted from its array on first access."""

    def __init__(self, optional: bool = False) -> None:
        self.optional = optional

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, of: None, owner: type) -> Held: ...
    @overload
    def __get__(self, of: object, owner: type) -> Held: ...
    def __get__(self, of: object | None, owner: type) -> Any:
        if of is None:  # dataclass reads the default
            if self.optional:
                return None
            raise AttributeError(self.name)
        value = of.__dict__.get(self.name)
        if isinstance(value, np.ndarray):
            import torch

            value = of.__dict__[self.name] = torch.from_numpy(value)
        return value

    def __set__(self, of: object, value: Held) -> None:
        of.__dict__[self.name] = value


@dataclass(frozen=True, eq=False)
class Gaussians:
    """N anisotropic Gaussians in world space.

    Attributes:
        means: float32 [N, 3]. Centres, scene units.
        scales: float32 [N, 3]. Standard deviations along the local axes, scene units, positive.
        quats: float32 [N, 4]. Rotations local-to-world, wxyz; any length but zero is accepted.
        opacities: float32 [N]. In [0, 1].
        sh: float32 [N, K, 3]. Spherical-harmonic colour, K = (degree + 1)^2.
        source: int32 [N]. Flat index ``(view * H + row) * W + column`` of the context pixel of each
            Gaussian; -1 for all where they are of no pixel, as those of another program.
        features: float32 [N, D] or None. Semantic features. In a field: the ID code (3-dimensional
            in the paper) times its weight, and the weight; see
            :class:`slgaussian.semantic.Lifting`.
        guessed: bool [N] or None. True if no second view confirms the depth
            (:func:`slgaussian.build.predict`). Predictors set it for occluded Gaussians and those
            outside the views. None if unknown.
        origin: float64 [3]. Point of the world to which ``means`` are relative, zero unless
            float32 cannot hold them in the world (:func:`slgaussian.scene.local_origin`). Cameras
            are in the world; :meth:`localize` brings one to the means.

    Raises:
        InputError: If shapes disagree; :meth:`check` checks the values.
    """

    means: _Tensor[torch.Tensor] = _Tensor()
    scales: _Tensor[torch.Tensor] = _Tensor()
    quats: _Tensor[torch.Tensor] = _Tensor()
    opacities: _Tensor[torch.Tensor] = _Tensor()
    sh: _Tensor[torch.Tensor] = _Tensor()
    source: _Tensor[torch.Tensor] = _Tensor()
    features: _Tensor[torch.Tensor | None] = _Tensor(optional=True)
    guessed: _Tensor[torch.Tensor | None] = _Tensor(optional=True)
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3), repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        shapes = {name: tuple(value.shape) for name, value in self._present()}
        n = len(self)
        tails = {"means": (3,), "scales": (3,), "quats": (4,), "opacities": (), "source": ()}
        tails |= {"guessed": (), "sh": (*shapes["sh"][1:2], 3)}
        for name, shape in shapes.items():
            expected = (n, *(shape[1:] if name == "features" else tails[name]))
            if shape != expected:
                raise InputError(f"gaussians {name}: found shape {shape}, expected {expected}")
        if np.shape(self.origin) != (3,) or not np.isfinite(self.origin).all():
            raise InputError(f"gaussians origin: found {self.origin}, expected 3 finite numbers")

    def __len__(self) -> int:
        return int(self.__dict__["means"].shape[0])

    def __getitem__(self, keep: torch.Tensor | np.ndarray) -> Gaussians:
        """Select Gaussians by a boolean mask [N] or indices, as array or tensor."""
        if isinstance(keep, np.ndarray):
            if all(isinstance(value, np.ndarray) for _, value in self._present()):
                return self.with_arrays(**{name: value[keep] for name, value in self._present()})
            import torch

            keep = torch.from_numpy(keep)
        chosen: Any = {name: value[keep] for name, value in self.items()}
        return replace(self, **chosen)

    @property
    def pixelwise(self) -> bool:
        """Whether each Gaussian is of a context pixel, which ``source`` names."""
        return not (self.to_arrays()["source"] < 0).any()

    def reach(self, camera: Camera) -> float:
        """Return the distance from ``camera`` of the 95th percentile of a sample of the means."""
        means = _to_array(self.__dict__["means"][:: -(-len(self) // 1000) or 1])
        offsets = means.astype(np.float64) - self.localize(camera).center
        return float(np.percentile(np.linalg.norm(offsets, axis=1), 95)) if len(means) else 1.0

    def localize(self, camera: Camera) -> Camera:
        """Return a camera of the world in the coordinates of ``means``."""
        return camera.relative_to(self.origin)

    def place(self, frame: Frame) -> Gaussians:
        """Return Gaussians of a local frame in the unit of the world, with the frame's origin."""
        if frame.unit == 1 and not frame.origin.any():
            return self
        unit = np.float32(frame.unit)
        arrays = {name: self.to_arrays()[name] * unit for name in ("means", "scales")}
        origin = frame.origin + frame.unit * self.origin
        return replace(self.with_arrays(**arrays), origin=origin)

    def _present(self) -> list[tuple[str, Any]]:
        """Return the (name, tensor or array [N, ...]) pairs that are not None, unconverted."""
        stored, names = self.__dict__, (f.name for f in fields(self) if f.name != "origin")
        return [(name, stored[name]) for name in names if stored.get(name) is not None]

    @property
    def is_cuda(self) -> bool:
        """True if the tensors are on a GPU; False for arrays."""
        return bool(getattr(self.__dict__["means"], "is_cuda", False))

    def items(self) -> list[tuple[str, torch.Tensor]]:
        """Return the (name, tensor) pairs that are not None."""
        return [(name, getattr(self, name)) for name, _ in self._present()]

    def require_features(self) -> torch.Tensor:
        """Return the features, float32 [N, D]; InputError if there are none."""
        if self.features is None:
            raise InputError("gaussians features: found none, expected some in a semantic field")
        return self.features

    def check(self) -> None:
        """Raise :class:`InputError` with the field and index of the first invalid value.

        Invalid are NaN, infinity, negative scales, opacities outside [0, 1] and quaternions of
        length zero.
        """
        for name, value in self._present():
            if (index := first_not_finite(value)) is not None:
                raise InputError(f"gaussians {name}[{index}]: holds NaN or infinity")
        arrays = self.to_arrays()
        scales, opacities, quats = (arrays[name] for name in ("scales", "opacities", "quats"))
        rules = {
            "scales": ((scales < 0).any(1), "expected 0 or more"),
            "opacities": ((opacities < 0) | (opacities > 1), "expected 0 to 1"),
            "quats": ((quats == 0).all(1), "a quaternion of length zero is no rotation"),
        }
        for name, (bad, expected) in rules.items():
            if bad.any():
                index = int(np.flatnonzero(bad)[0])
                entry = arrays[name][index].tolist()
                raise InputError(f"gaussians {name}[{index}]: found {entry}, {expected}")

    def colours(self) -> torch.Tensor:
        """Compute view-independent RGB, float [N, 3], from the degree-0 part of ``sh``."""
        return self.sh[:, 0] * SH_C0 + 0.5

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Return NumPy arrays by field name, as stored in ``gaussians.npz``.

        ``origin`` is among them unless it is zero.
        """
        arrays = {name: _to_array(value) for name, value in self._present()}
        return {**arrays, "origin": self.origin} if self.origin.any() else arrays

    @staticmethod
    def from_arrays(arrays: Mapping[str, np.ndarray]) -> Gaussians:
        """Inverse of :meth:`to_arrays`. Tensors are created from the arrays on first access.

        They share memory with writable arrays; read-only arrays are copied.
        """
        stored: Any = {n: a if a.flags.writeable else a.copy() for n, a in arrays.items()}
        return Gaussians(**stored)

    def with_arrays(self, **arrays: np.ndarray) -> Gaussians:
        """Return a copy with some fields replaced; the other fields are shared."""
        changed: Any = {**dict(self._present()), **arrays}
        return replace(self, **changed)

    @staticmethod
    def concatenate(parts: Sequence[Gaussians]) -> Gaussians:
        """Concatenate Gaussians, which must have the same fields and origin."""
        joined: Any
        names = [name for name, _ in parts[0]._present()]
        if all(isinstance(value, np.ndarray) for part in parts for _, value in part._present()):
            joined = {n: np.concatenate([part.__dict__[n] for part in parts]) for n in names}
            return parts[0].with_arrays(**joined)
        import torch

        joined = {n: torch.cat([getattr(part, n) for part in parts]) for n in names}
        return replace(parts[0], **joined)


def first_not_finite(values: torch.Tensor | np.ndarray) -> int | None:
    """Return the index of the first row with NaN or infinity, or None."""
    # In NumPy: the check takes less time than torch needs to wake its threads.
    finite = np.isfinite(_to_array(values))
    return None if finite.all() else int(np.argwhere(~finite)[0, 0])


def _to_array(values: torch.Tensor | np.ndarray) -> np.ndarray:
    return values if isinstance(values, np.ndarray) else values.detach().cpu().numpy()


def rgb_to_sh(rgb: Numbers) -> Numbers:
    """Convert view-independent colours [N, 3] in [0, 1] to degree-0 coefficients [N, 1, 3]."""
    return ((rgb - 0.5) / SH_C0)[:, None]


def rotation_matrices(quats: torch.Tensor) -> torch.Tensor:
    """Convert quaternions wxyz [N, 4] of any length to rotation matrices [N, 3, 3]."""
    w, x, y, z = (quats / quats.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    import torch

    return torch.stack(rows, -1).reshape(*quats.shape[:-1], 3, 3)


def source_depths(gaussians: Gaussians, cameras: Sequence[Camera]) -> np.ndarray:
    """Compute depth maps of the context views from the Gaussians of their pixels.

    A pixel without a Gaussian, because those of other views cover its surface, has the depth of the
    nearest Gaussian of another view that projects to it or to one of its 8 neighbours.

    Args:
        cameras: sequence of V Camera. The context cameras, in order, all of one size.

    Returns:
        float32 [V, H, W]: z-depth in scene units; 0 without Gaussians, and in views none of whose
            pixels has one.
    """
    from scipy.ndimage import minimum_filter

    H, W = cameras[0].height, cameras[0].width
    depths = np.zeros((len(cameras), H * W), np.float32)
    arrays = gaussians.to_arrays()
    source, means = arrays["source"], arrays["means"].astype(np.float64)
    for index, (camera, depth) in enumerate(zip(cameras, depths, strict=True)):
        in_view = source // (H * W) == index
        pixels, z = gaussians.localize(camera).project(means)
        depth[source[in_view] % (H * W)] = z[in_view]
        if not in_view.any() or (depth > 0).all():
            continue
        nearest = np.full((H, W), np.inf, np.float32)
        inside = ~in_view & camera.shows(pixels, z)
        column, row = pixels[inside].astype(np.int64).T
        np.minimum.at(nearest, (row, column), z[inside].astype(np.float32))
        # Points do not project to every pixel.
        smallest = minimum_filter(nearest, 3)
        filled = np.where(np.isfinite(nearest), nearest, smallest).ravel()
        depth[:] = np.where((depth == 0) & np.isfinite(filled), filled, depth)
    return depths.reshape(len(cameras), H, W)
