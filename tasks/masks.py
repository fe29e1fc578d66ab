"""Label maps of the context views of one scene."""

from __future__ import annotations

from typing import Any

from slgaussian.build import label_views
from slgaussian.gaussians import Gaussians
from slgaussian.parts.identity import DIGESTS, placed
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.artifacts import labels_to_arrays, sample_from_arrays
from tasks.stage import CHANGED, StageCall

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
    label_maps = label_views(sample, gaussians, **named, settings=own_settings(call))
    return store.put("labels", labels_to_arrays(label_maps), {"objects": len(label_maps.ids)})


def own_settings(call: StageCall) -> dict[str, dict[str, Any]]:
    """The settings of the proposer and the tracker, each under its name, its files by place."""
    own = {}
    for name in (call.settings["proposer"], call.settings["tracker"]):
        table = call.settings.get(name, {})
        place = call.where.get(name)
        if place is not None:
            key = next(key for key in DIGESTS if key in table)
            table = placed(table, {key: place}, CHANGED)
        own[name] = dict(table)
    return own
