"""Base Gaussians from the context views of one scene."""

from __future__ import annotations

from slgaussian.build import predict
from slgaussian.parts.identity import placed
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.artifacts import sample_from_arrays
from tasks.stage import CHANGED, StageCall

STAGE = "geometry"
VERSION = 3


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``gaussians``. Settings: predictor, seed, under its name its own. Inputs: sample.

    Also ``trust_cameras``, which may be left out.
    ``where["checkpoint"]`` is the file that the predictor's settings hold the SHA-256 of.
    """
    sample = sample_from_arrays(store.get(call.inputs["sample"]))
    name = call.settings["predictor"]
    own = placed(call.settings.get(name, {}), call.where, CHANGED)
    trust = call.settings.get("trust_cameras", False)
    gaussians = predict(sample, name, call.settings["seed"], {name: own}, trust)
    gaussians.check()
    return store.put("gaussians", gaussians.to_arrays(), {"gaussians": len(gaussians)})
