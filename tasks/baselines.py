"""Ask another method everything the truth of one scene knows, as the field of it is asked."""

from __future__ import annotations

import time

from slgaussian.benchmark.baselines import load_method
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.benchmark.evaluate import EvaluationSettings, evaluate
from slgaussian.labels import LabelMaps
from slgaussian.language.query import Rules
from slgaussian.masks import load_proposer
from slgaussian.parts.identity import placed
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.artifacts import (
    get_field,
    result_to_arrays,
    sample_from_arrays,
    truth_from_arrays,
)
from tasks.stage import CHANGED, StageCall

STAGE = "baselines"
VERSION = 3


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``scene_result``, without pictures. Inputs: sample, truth, labels, field.

    Settings: method (its name in tables), of (its name in the registry), own (its settings),
    dataset, queries, rules; place, if the data have it. ``where[key]`` is the file of the encoder
    that the field's settings hold the digest of, ``where["part.key"]`` that of another part.
    """
    sample = sample_from_arrays(store.get(call.inputs["sample"]))
    of_encoder = {key: place for key, place in call.where.items() if "." not in key}
    field = get_field(store, call.inputs["field"], of_encoder)
    label_maps = LabelMaps(**store.get(call.inputs["labels"]))
    truth = truth_from_arrays(store.get(call.inputs["truth"]))
    proposer, lifting = field.settings["proposer"], field.settings["lifting"]
    own = {}
    for part in (proposer, lifting):
        where = {
            key.removeprefix(f"{part}."): place
            for key, place in call.where.items()
            if key.startswith(f"{part}.")
        }
        own[part] = placed(field.settings.get(part, {}), where, CHANGED)
    queries = call.settings["queries"]
    asked = [text for masks in truth.masks.values() for text in masks]
    inputs = Inputs(
        sample=sample,
        field=field,
        label_maps=label_maps,
        proposer=load_proposer(proposer, **own[proposer]),
        seed=field.settings["seed"],
        settings=own,
        classes=tuple(dict.fromkeys([*asked, *queries])),
    )
    begun = time.perf_counter()
    method = load_method(call.settings["of"], **call.settings["own"])(inputs)
    prepared = time.perf_counter() - begun
    result = evaluate(
        method,
        sample,
        label_maps,
        truth,
        EvaluationSettings(
            method=call.settings["method"],
            dataset=call.settings["dataset"],
            place=call.settings.get("place"),
            queries=queries,
            rules=Rules(**call.settings["rules"]),
            drawn=False,
        ),
    )
    times = {"prepare": prepared, **result.times}
    return store.put("scene_result", result_to_arrays(result), {"times": times})
