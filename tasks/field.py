"""The semantic field of one scene."""

from __future__ import annotations

from dataclasses import replace

from slgaussian.build import lift_field
from slgaussian.cameras.quality import Quality
from slgaussian.gaussians import Gaussians
from slgaussian.language.bank import MemoryBank
from slgaussian.parts.method import Method
from slgaussian.predict import Depths
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import labels_from_arrays, put_field, sample_from_arrays
from tasks.context import RunContext
from tasks.stage import stage


@stage("field", version=8)
def field(
    run: RunContext,
    sample: ArtifactRef,
    gaussians: ArtifactRef,
    labels: ArtifactRef,
    bank: ArtifactRef,
    method: Method,
) -> ArtifactRef:
    """Gaussians, label maps and bank joined: spec ``field``."""
    depths = gaussians.meta["depths"]
    joined = lift_field(
        run.read(sample, sample_from_arrays),
        run.read(gaussians, Gaussians.from_arrays),
        replace(run.read(labels, labels_from_arrays), computed=labels.meta["computed"]),
        run.read(bank, MemoryBank.from_arrays),
        method,
        Quality(**gaussians.meta["quality"]),
        None if depths is None else Depths(*depths),
    )
    return put_field(run.store, joined)
