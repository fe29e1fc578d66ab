"""The semantic field of one scene."""

from __future__ import annotations

from slgaussian.build import lift_field
from slgaussian.gaussians import Gaussians
from slgaussian.labels import LabelMaps
from slgaussian.language.bank import MemoryBank
from slgaussian.parts.identity import placed
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.artifacts import put_field, sample_from_arrays
from tasks.stage import CHANGED, StageCall

STAGE = "field"
VERSION = 4


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``field``. Settings: those of the whole method. Inputs: sample, gaussians, labels, bank.

    ``where["weights"]`` is the place of those that the settings of the lifting hold the digest of.
    """
    sample = sample_from_arrays(store.get(call.inputs["sample"]))
    gaussians = Gaussians.from_arrays(store.get(call.inputs["gaussians"]))
    label_maps = LabelMaps(**store.get(call.inputs["labels"]))
    bank = MemoryBank.from_arrays(store.get(call.inputs["bank"]))
    settings = {"scene": sample.scene, **call.settings}
    name = settings["lifting"]
    own = placed(settings.get(name, {}), call.where, CHANGED)
    field = lift_field(sample, gaussians, label_maps, bank, name, settings, own=own)
    return put_field(store, field)
