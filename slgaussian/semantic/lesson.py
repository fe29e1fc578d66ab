"""Training and evaluation samples of the semantic branch.

A lesson has the frozen base Gaussians of two or more context views, the labels of these views, and
labels of other views of the same scene as targets of the rendered features (section 3.1 of the
paper, and its Implementation Details).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.io import short_repr
from slgaussian.kernels.seeding import hash_arrays
from slgaussian.scene import Camera

GEOMETRY = ("means", "scales", "quats", "opacities", "source")
"""Arrays of the Gaussians that a lesson stores; colours are not needed."""


@dataclass(frozen=True, eq=False)
class Lesson:
    """One training sample, without ID codes, which are drawn anew in every epoch.

    Attributes:
        sample: Unique name: the clip and its frames.
        gaussians: Predicted from the context views; ``source`` is a flat index into ``labels``.
            Features and colours are not used; colours are not stored.
        labels: int32 [V, H, W]. Object ids of the context views, 0 unassigned.
        cameras: tuple of T Camera. Cameras of the target views, H x W pixels. Where the Gaussians
            have an origin, both are made relative to it, and the origin is dropped.
        targets: int32 [T, H, W]. Object ids of the target views, consistent with ``labels``; 0
            unassigned.
        opaque: bool [T, H, W] or None. False where the photograph of a target is transparent:
            nothing is known of it there. None where all is opaque.

    Raises:
        InputError: If an attribute is invalid; the message names the sample.
    """

    sample: str
    gaussians: Gaussians
    labels: np.ndarray
    cameras: tuple[Camera, ...]
    targets: np.ndarray
    opaque: np.ndarray | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        # All positions are relative, so that random draws do not depend on the origin either.
        cameras = tuple(map(self.gaussians.localize, self.cameras))
        gaussians = replace(self.gaussians, origin=np.zeros(3))
        self.__dict__.update(cameras=cameras, gaussians=gaussians)
        size = self.labels.shape[1:]
        sizes = [(camera.height, camera.width) for camera in self.cameras]
        source, problem = self.gaussians.source, ""
        if self.targets.shape != (len(sizes), *size) or sizes != [size] * len(sizes):
            problem = (
                f"targets {self.targets.shape} and cameras of {sizes} for labels "
                f"{self.labels.shape}, expected a target map for each camera, all of the size of "
                "the labels"
            )
        elif not self.cameras:
            problem = "no target view, expected at least one"
        elif not self.gaussians.pixelwise:
            problem = "the Gaussians of a splat that exists, expected one for each pixel"
        elif len(source) and not 0 <= int(source.min()) <= int(source.max()) < self.labels.size:
            problem = (
                f"a Gaussian from pixel {int(source.min())} or {int(source.max())}, expected "
                f"pixels 0 to {self.labels.size - 1} of the context views"
            )
        if problem:
            raise InputError(f"lesson {self.sample!r}: found {problem}")

    @cached_property
    def content(self) -> str:
        """Digest that seeds random draws: of labels and cameras, not of the sample's name."""
        cameras = [np.stack([camera.K for camera in self.cameras])]
        cameras.append(np.stack([camera.c2w for camera in self.cameras]))
        return hash_arrays(self.labels, self.targets, *cameras)

    def counts(self) -> dict[str, Any]:
        """Return numbers of Gaussians and objects, and shares of unlabelled pixels, by column."""
        return {
            "gaussians": len(self.gaussians),
            "objects": int((np.unique(self.labels) > 0).sum()),
            "shared": int((np.unique(self.targets) > 0).sum()),
            "unlabelled_context": float((self.labels == 0).mean()),
            "unlabelled_target": float((self.targets == 0).mean()),
        }

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays by name, in the layout of ``data_specs/lesson.toml``."""
        geometry = self.gaussians.to_arrays()
        return {
            "sample": np.array(self.sample),
            **{name: geometry[name] for name in GEOMETRY},
            "labels": self.labels,
            "targets": self.targets,
            **({} if self.opaque is None else {"opaque": self.opaque}),
            "K": np.stack([camera.K for camera in self.cameras]),
            "c2w": np.stack([camera.c2w for camera in self.cameras]),
            "near_far": np.array([[c.near or 0, c.far or 0] for c in self.cameras], np.float64),
        }

    @staticmethod
    def from_arrays(arrays: Mapping[str, np.ndarray]) -> Lesson:
        """Inverse of :meth:`to_arrays`; the Gaussians have no colours, sh [N, 0, 3]."""
        geometry: Any = {name: torch.from_numpy(np.array(arrays[name])) for name in GEOMETRY}
        gaussians = Gaussians(**geometry, sh=torch.zeros(len(geometry["means"]), 0, 3))
        height, width = arrays["targets"].shape[1:]
        views = zip(arrays["K"], arrays["c2w"], arrays["near_far"].tolist(), strict=True)
        cameras = tuple(
            Camera(K, c2w, width, height, near or None, far or None)
            for K, c2w, (near, far) in views
        )
        name, labels = str(arrays["sample"]), arrays["labels"]
        targets, opaque = arrays["targets"], arrays.get("opaque")
        return Lesson(name, gaussians, labels, cameras, targets, opaque)
