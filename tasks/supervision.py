"""ID codes and the memory bank of one scene: what a field is taught."""

from __future__ import annotations

from slgaussian.build import remember
from slgaussian.labels import LabelMaps
from slgaussian.store import ArtifactRef, ArtifactStore
from tasks.artifacts import sample_from_arrays
from tasks.stage import StageCall

STAGE = "supervision"
VERSION = 1


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``bank``. Settings: encoder, codes, seed. Inputs: sample, labels.

    The code images of the paper are ``bank.codes`` looked up by the label maps, so they are not
    stored again.
    """
    sample = sample_from_arrays(store.get(call.inputs["sample"]))
    label_maps = LabelMaps(**store.get(call.inputs["labels"]))
    bank = remember(sample, label_maps, **call.settings)
    return store.put("bank", bank.to_arrays(), {"objects": len(bank)})
