"""ID codes and the memory bank of one scene: what a field is taught."""

from __future__ import annotations

from slgaussian.build import remember
from slgaussian.gaussians import Gaussians
from slgaussian.labels import LabelMaps
from slgaussian.parts.identity import placed
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.artifacts import sample_from_arrays
from tasks.stage import CHANGED, StageCall

STAGE = "supervision"
VERSION = 4


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``bank``. Settings: encoder, codes, seed, and under the name of a part its own.

    Inputs: sample, gaussians, labels. ``where[key]`` is the file of the encoder that its settings
    hold the digest of.

    The code images of the paper are ``bank.codes`` looked up by the label maps, so they are not
    stored again.
    """
    sample = sample_from_arrays(store.get(call.inputs["sample"]))
    gaussians = Gaussians.from_arrays(store.get(call.inputs["gaussians"]))
    label_maps = LabelMaps(**store.get(call.inputs["labels"]))
    named = {name: call.settings[name] for name in ("encoder", "codes", "seed")}
    own = {name: table for name, table in call.settings.items() if name not in named}
    if call.where:
        own[named["encoder"]] = placed(own[named["encoder"]], call.where, CHANGED)
    bank = remember(sample, gaussians, label_maps, **named, settings=own)
    return store.put("bank", bank.to_arrays(), {"objects": len(bank)})
