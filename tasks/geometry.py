"""Base Gaussians from the context views of one scene."""

from __future__ import annotations

from slgaussian.build import predict
from slgaussian.parts.part import Part
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import sample_from_arrays
from tasks.stage import Worksite, stage


@stage("geometry", version=3)
def geometry(
    site: Worksite, sample: ArtifactRef, predictor: Part, seed: int, trust_cameras: bool = False
) -> ArtifactRef:
    """What the predictor makes of the context views: spec ``gaussians``."""
    shown = site.read(sample, sample_from_arrays)
    gaussians = predict(shown, predictor, seed, trust_cameras)
    gaussians.check()
    return site.store.put("gaussians", gaussians.to_arrays(), {"gaussians": len(gaussians)})
