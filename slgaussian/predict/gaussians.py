"""The predictor ``gaussians``: the splat of another program, which stays as it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian.errors import InputError
from slgaussian.formats.splats import READERS, load_gaussians
from slgaussian.gaussians import Gaussians
from slgaussian.predict.configs import ExistingGaussiansConfig
from slgaussian.scene import Sample


class ExistingGaussians(ExistingGaussiansConfig):
    """Gaussians from a file (:mod:`slgaussian.formats.splats`), in the world of the cameras.

    In a folder, the file of a scene has its name.

    Raises:
        InputError: If there is no such file or folder. When called: if it cannot be read, or holds
            no visible Gaussian.
    """

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        if self.splat is None:
            raise InputError(
                "gaussians splat: none given; give a .ply or .spz, as in --set "
                "gaussians.splat=scene.ply"
            )
        if not Path(self.splat).exists():
            raise InputError(f"gaussians splat: there is no {str(self.splat)!r}")

    def __call__(self, sample: Sample, seed: int = 0) -> Gaussians:
        """Read the Gaussians of the scene of ``sample``; the result ignores ``seed``."""
        return self.read(sample.scene)

    def read(self, scene: str) -> Gaussians:
        """Read the Gaussians of a scene as they are; ``source`` is -1, as they are of no pixel."""
        file = self._find(scene)
        gaussians, _ = load_gaussians(file)
        arrays = gaussians.to_arrays()
        if not (arrays["opacities"] > 0).any():
            raise InputError(
                f"{file}: none of its {len(gaussians)} Gaussians is visible; give a splat with "
                "opacities above 0"
            )
        arrays = {name: arrays[name] for name in ("means", "scales", "quats", "opacities", "sh")}
        arrays["source"] = np.full(len(gaussians), -1, np.int32)
        return replace(Gaussians.from_arrays(arrays), origin=gaussians.origin)

    def _find(self, scene: str) -> Path:
        assert self.splat is not None  # checked by __init__
        place = Path(self.splat)
        if not place.is_dir():
            return place
        if (place / "field.json").is_file():
            raise InputError(
                f"{place}: is a field, which answers words already; ask it by `slgaussian query`, "
                "or write its Gaussians as a .ply by `slgaussian export`"
            )
        for suffix in READERS:
            if (file := place / f"{scene}{suffix}").is_file():
                return file
        raise InputError(
            f"{place}: has no splat of scene {scene!r}; expected {scene} with "
            f"{' or '.join(READERS)}"
        )
