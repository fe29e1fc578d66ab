"""Label maps of the context views of one scene."""

from __future__ import annotations

from slgaussian.build import DIGESTS, label_views
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.store import ArtifactRef, ArtifactStore
from tasks.artifacts import labels_to_arrays, sample_from_arrays
from tasks.stage import StageCall

STAGE = "masks"
VERSION = 2


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``labels``. Inputs: sample, gaussians.

    Settings: proposer, tracker, replicas, and under the name of a part its own. ``where[part]`` is
    the model or folder that the part's settings hold the digest of.
    """
    sample = sample_from_arrays(store.get(call.inputs["sample"]))
    gaussians = Gaussians.from_arrays(store.get(call.inputs["gaussians"]))
    named = {name: call.settings[name] for name in ("proposer", "tracker", "replicas")}
    own = {name: table for name, table in call.settings.items() if name not in named}
    for name, place in call.where.items():
        key = next(key for key in DIGESTS if key in own[name])
        if DIGESTS[key](place) != own[name][key]:
            raise InputError(f"{place}: was changed after the run had begun; start the run again")
        own[name] = {**own[name], key: place}
    label_maps = label_views(sample, gaussians, **named, settings=own)
    return store.put("labels", labels_to_arrays(label_maps), {"objects": len(label_maps.ids)})
