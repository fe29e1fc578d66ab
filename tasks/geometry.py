"""Base Gaussians from the context views of one scene."""

from __future__ import annotations

from slgaussian.predict import load_predictor
from slgaussian.store import ArtifactRef, ArtifactStore
from tasks.artifacts import sample_from_arrays
from tasks.stage import StageCall

STAGE = "geometry"
VERSION = 1


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``gaussians``. Settings: predictor. Inputs: sample."""
    sample = sample_from_arrays(store.get(call.inputs["sample"]))
    gaussians = load_predictor(call.settings["predictor"])(sample)
    gaussians.check()
    return store.put("gaussians", gaussians.to_arrays(), {"gaussians": len(gaussians)})
