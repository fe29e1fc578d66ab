"""The report of a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from slgaussian.benchmark.report import Scene, render_report
from slgaussian.storage.store import Arrays, ArtifactRef, ArtifactStore
from tasks.artifacts import (
    Decoded,
    pictures_of,
    predictions_of,
    result_from_arrays,
    truth_from_arrays,
)
from tasks.stage import StageCall

STAGE = "report"
VERSION = 5


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``report``. Settings: scenes, manifest, failures.

    ``scenes`` is a list of ``scene``, ``answer``, ``truth``, ``attribution`` and ``others``: the
    names of inputs, of the result of our method, the truth, what lost its misses, and by method the
    results of others. Images are read a scene at a time.

    The report has no times in it: it is the same whenever and wherever it is made.
    """
    scenes = [_scene(store, call.inputs, entry) for entry in call.settings["scenes"]]
    tables = [store.get(call.inputs[entry["attribution"]]) for entry in call.settings["scenes"]]
    attribution = [row for table in tables for row in table.to_pylist()]
    made = render_report(scenes, call.settings["manifest"], call.settings["failures"], attribution)
    forms = {"html": made.html, "markdown": made.markdown}
    arrays = {name: np.frombuffer(text.encode(), np.uint8) for name, text in forms.items()}
    return store.put("report", arrays)


def _scene(
    store: ArtifactStore, inputs: Mapping[str, ArtifactRef], entry: Mapping[str, Any]
) -> Scene:
    def read(name: str) -> Arrays:
        return store.get(inputs[name])

    names = [entry["answer"], *entry["others"].values()]
    own, *others = (result_from_arrays(read(name), {}, with_images=False) for name in names)

    return Scene(
        name=entry["scene"],
        dataset=own.dataset,
        rows=[row for each in (own, *others) for row in each.rows],
        metrics=own.scene_metrics,
        pictures=lambda: Decoded(pictures_of(read(entry["answer"]))),
        truth=lambda: truth_from_arrays(read(entry["truth"])).masks,
        masks=lambda method: Decoded(predictions_of(read(entry["others"].get(method, names[0])))),
    )
