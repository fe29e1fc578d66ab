"""Label maps of the context views of one scene."""

from __future__ import annotations

from slgaussian.build import label_views
from slgaussian.gaussians import Gaussians
from slgaussian.store import ArtifactRef, ArtifactStore
from tasks.artifacts import labels_to_arrays, sample_from_arrays
from tasks.stage import StageCall

STAGE = "masks"
VERSION = 1


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``labels``. Settings: proposer, tracker, replicas. Inputs: sample, gaussians."""
    sample = sample_from_arrays(store.get(call.inputs["sample"]))
    gaussians = Gaussians.from_arrays(store.get(call.inputs["gaussians"]))
    label_maps = label_views(sample, gaussians, **call.settings)
    return store.put("labels", labels_to_arrays(label_maps), {"objects": len(label_maps.ids)})
