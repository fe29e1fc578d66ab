"""Base Gaussians of all samples of a chunk: the slow part, kept apart from what masks change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pyarrow as pa

from slgaussian.datasets.re10k import Clip
from slgaussian.errors import InputError
from slgaussian.parts.identity import placed
from slgaussian.predict import load_predictor
from slgaussian.scene import Sample, View
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks import geometry
from tasks.chunks import left_out, read_chunk
from tasks.stage import CHANGED, StageCall

STAGE = "predictions"
VERSION = 1000 * geometry.VERSION + 1
"""Raised with that of the stage that does the same for a single scene."""


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``predictions``. Inputs: pairs.

    Settings: chunk (its SHA-256), size, near, far, seed, predictor, and under its name its own.
    ``where["chunk"]`` is the chunk, ``where["checkpoint"]`` the file that the predictor's settings
    hold the SHA-256 of. A sample that cannot be done is named in ``meta["left_out"]``.
    """
    clips = read_chunk(store, call)
    name = call.settings["predictor"]
    places = {key: place for key, place in call.where.items() if key != "chunk"}
    predict = load_predictor(name, **placed(call.settings.get(name, {}), places, CHANGED))
    rows, bad = [], []
    for row in store.get(call.inputs["pairs"]).to_pylist():
        try:
            sample = read_sample(clips[row["clip"]], row, call.settings, targets=False)
            gaussians = predict(sample, call.settings["seed"])
            gaussians.check()
        except InputError as error:
            bad.append(left_out(row["sample"], error))
            continue
        ref = store.put("gaussians", gaussians.to_arrays())
        made = {"sample": row["sample"], "uri": ref.uri, "digest": ref.digest}
        rows.append({**made, "gaussians": len(gaussians)})
    table = pa.Table.from_pylist(rows, schema=load_spec("predictions").schema)
    parts = [row["uri"] for row in rows]
    meta = {"samples": len(rows), "left_out": bad, "parts": parts}
    return store.put("predictions", table, meta)


def read_sample(
    clip: Clip, row: Mapping[str, Any], settings: Mapping[str, Any], targets: bool
) -> Sample:
    """The sample that a row of spec ``pairs`` describes, at the size of the settings.

    Its targets, which take as long to decode, only if wanted.

    Raises
    ------
    InputError
        If a view cannot be decoded, or the views do not make a sample.
    """
    height, width = settings["size"]
    known = {name: settings[name] for name in ("near", "far") if settings.get(name) is not None}

    def views(role: str) -> tuple[View, ...]:
        names = [name for name in row if name.startswith(role)]
        found = [clip.view(row[name]).resized(height, width) for name in names]
        return tuple(replace(v, camera=replace(v.camera, **known)) for v in found)

    return Sample(row["sample"], views("context_"), views("target_") if targets else ())
