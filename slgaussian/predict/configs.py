"""Configs of the predictors."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from slgaussian.components.config import ComponentConfig, File
from slgaussian.io import file_digest
from slgaussian.masks.configs import PrecomputedConfig

PREDICTORS = {
    "planesweep": "slgaussian.predict.configs:PlaneSweepConfig",
    "mvsplat": "slgaussian.predict.configs:MVSplatConfig",
    "precomputed": "slgaussian.predict.configs:PrecomputedGeometryConfig",
    "gaussians": "slgaussian.predict.configs:ExistingGaussiansConfig",
}


class PlaneSweepConfig(ComponentConfig, title="planesweep"):
    """Depth by plane sweep and semi-global matching, one Gaussian a context pixel and some more."""

    target = "slgaussian.predict.planesweep:PlaneSweep"

    depth_candidates: int = Field(
        144,
        ge=8,
        le=512,
        description="Largest number of depth candidates, 8 to 512; a pair gets no more than it "
        "needs.",
    )


class MVSplatConfig(ComponentConfig, title="mvsplat"):
    """MVSplat (Chen et al., ECCV 2024) with published weights, one Gaussian a context pixel."""

    target = "slgaussian.predict.mvsplat.predictor:MVSplat"

    checkpoint: Annotated[Path | None, File(file_digest)] = Field(
        None, description="Weights of mvsplat, such as re10k.ckpt."
    )
    precision: Literal["float32", "bfloat16"] = Field(
        "float32", description="Precision of mvsplat's layers: float32 or bfloat16."
    )


class PrecomputedGeometryConfig(PrecomputedConfig, title="precomputed"):
    """Depth from files of Depth Anything 3, DUSt3R or a phone, one Gaussian a pixel."""

    target = "slgaussian.predict.precomputed:PrecomputedGeometry"


def splat_digest(place: str | Path) -> str:
    """Compute the SHA-256 of the splat at ``place``, or of the names and splats of a folder."""
    from slgaussian.formats.splats import READERS  # which imports OpenCV

    place = Path(place)
    if not place.is_dir():
        return file_digest(place)
    digest = hashlib.sha256()
    for file in sorted(place.iterdir()):
        if file.suffix.lower() in READERS:
            digest.update(f"{file.name}\0{file_digest(file)}\n".encode())
    return digest.hexdigest()


class ExistingGaussiansConfig(ComponentConfig, title="gaussians"):
    """Gaussians of another program, which stay as they are."""

    target = "slgaussian.predict.gaussians:ExistingGaussians"

    splat: Annotated[Path | None, File(splat_digest)] = Field(
        None,
        description="File of Gaussians, .ply or .spz, or a folder of them with one for each scene.",
    )
