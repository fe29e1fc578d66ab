"""Base Gaussians from the context views of one scene."""

from __future__ import annotations

from slgaussian.errors import InputError
from slgaussian.predict import load_predictor
from slgaussian.store import ArtifactRef, ArtifactStore, sha256_of
from tasks.artifacts import sample_from_arrays
from tasks.stage import StageCall

STAGE = "geometry"
VERSION = 2


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``gaussians``. Settings: predictor, and under its name its own. Inputs: sample.

    ``where["checkpoint"]`` is the file that the predictor's settings hold the SHA-256 of.
    """
    sample = sample_from_arrays(store.get(call.inputs["sample"]))
    name = call.settings["predictor"]
    own = dict(call.settings.get(name, {}))
    if "checkpoint" in own:
        file = call.where["checkpoint"]
        if sha256_of(file) != own["checkpoint"]:
            raise InputError(f"{file}: was changed after the run had begun; start the run again")
        own["checkpoint"] = file
    gaussians = load_predictor(name, **own)(sample)
    gaussians.check()
    return store.put("gaussians", gaussians.to_arrays(), {"gaussians": len(gaussians)})
