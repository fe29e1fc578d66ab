"""Find out what lost each query that the field of one scene missed."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from slgaussian.benchmark.attribution import attribute_errors
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.benchmark.evaluate import EvaluationSettings
from slgaussian.field import SemanticField
from slgaussian.labels import LabelMaps
from slgaussian.language.query import Rules
from slgaussian.masks import TRACKERS, load_proposer
from slgaussian.parts.identity import placed
from slgaussian.parts.registry import resolve
from slgaussian.scene import Sample
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.artifacts import get_field, sample_from_arrays, truth_from_arrays
from tasks.stage import CHANGED, StageCall

STAGE = "attribution"
VERSION = 1


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``attribution``. Settings: method, dataset, rules. Inputs: sample, truth, labels, field.

    ``where[key]`` is the file of the encoder that the field's settings hold the digest of,
    ``where["proposer.key"]`` that of the proposer, by its name.
    """
    sample = sample_from_arrays(store.get(call.inputs["sample"]))
    of_encoder = {key: place for key, place in call.where.items() if "." not in key}
    field = get_field(store, call.inputs["field"], of_encoder)
    label_maps = LabelMaps(**store.get(call.inputs["labels"]))
    truth = truth_from_arrays(store.get(call.inputs["truth"]))
    rows = []
    if any(mask.any() for masks in truth.masks.values() for mask in masks.values()):
        rows = attribute_errors(
            field,
            sample,
            label_maps,
            _pieces(call, field, sample, label_maps),
            truth,
            EvaluationSettings(**{**call.settings, "rules": Rules(**call.settings["rules"])}),
        )
    table = pa.Table.from_pylist(rows, schema=load_spec("attribution").schema)
    return store.put("attribution", table, {"misses": sum(row["lost"] is not None for row in rows)})


def _pieces(
    call: StageCall, field: SemanticField, sample: Sample, label_maps: LabelMaps
) -> np.ndarray:
    """What each view showed before association, int32 [V, H, W]: proposed once more."""
    made_by = field.settings
    if resolve("mask tracker", TRACKERS, made_by["tracker"]).final:
        return label_maps.labels
    name = made_by["proposer"]
    prefix = f"{name}."
    where = {
        key.removeprefix(prefix): place
        for key, place in call.where.items()
        if key.startswith(prefix)
    }
    proposer = load_proposer(name, **placed(made_by.get(name, {}), where, CHANGED))
    return Inputs(sample, field, label_maps, proposer).own_labels.labels
