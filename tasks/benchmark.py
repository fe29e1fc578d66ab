"""Ask the field of one scene everything its truth knows."""

from __future__ import annotations

from slgaussian.benchmark.evaluate import evaluate
from slgaussian.labels import LabelMaps
from slgaussian.language.query import Rules
from slgaussian.store import ArtifactRef, ArtifactStore
from tasks.artifacts import (
    field_from_arrays,
    result_to_arrays,
    sample_from_arrays,
    truth_from_arrays,
)
from tasks.stage import StageCall

STAGE = "benchmark"
VERSION = 6


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``scene_result``. Settings: method, dataset, queries, rules; place, if the data have it.

    Inputs: sample, truth, labels, field. ``where[key]`` is the file of the encoder that the field's
    settings hold the digest of.
    """
    sample = sample_from_arrays(store.get(call.inputs["sample"]))
    field = field_from_arrays(store.get(call.inputs["field"]), sample, call.where)
    label_maps = LabelMaps(**store.get(call.inputs["labels"]))
    truth = truth_from_arrays(store.get(call.inputs["truth"]))
    settings = {**call.settings, "rules": Rules(**call.settings["rules"])}
    result = evaluate(
        field,
        sample,
        label_maps,
        truth.masks,
        boxes=truth.boxes or None,
        gaussians=field.gaussians,
        bank=field.bank,
        **settings,
    )
    return store.put("scene_result", result_to_arrays(result), {"times": result.times})
