"""Base Gaussians of all samples of a chunk: the slow part, kept apart from what masks change."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pyarrow as pa

from slgaussian.components.component import Component
from slgaussian.datasets.re10k import Clip
from slgaussian.errors import InputError
from slgaussian.io import KnownFile
from slgaussian.scene import Sample, View
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef
from tasks.chunks import Framing, framed_views, left_out, read_chunk
from tasks.context import RunContext
from tasks.scene import geometry
from tasks.stage import stage


# Its version is raised with that of the stage that does the same for a single scene.
@stage("predictions", version=1000 * geometry.version + 1)
def predictions(
    run: RunContext,
    pairs: ArtifactRef,
    chunk: KnownFile,
    framing: Framing,
    predictor: Component,
    seed: int,
) -> ArtifactRef:
    """Gaussians of the samples of a chunk: spec ``predictions``.

    A sample that cannot be done is named in ``meta["left_out"]``.
    """
    store, clips, predict = run.store, read_chunk(run, chunk), predictor.load()
    rows, bad = [], []
    for row in store.get(pairs).to_pylist():
        try:
            sample = read_sample(clips[row["clip"]], row, framing, targets=False)
            gaussians = predict(sample, seed)
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


def read_sample(clip: Clip, row: Mapping[str, Any], framing: Framing, targets: bool) -> Sample:
    """The sample that a row of spec ``pairs`` describes, framed.

    Its targets, which take as long to decode, only if wanted.

    Raises
    ------
    InputError
        If a view cannot be decoded, or the views do not make a sample.
    """

    def views(role: str) -> tuple[View, ...]:
        return framed_views(clip, [row[name] for name in row if name.startswith(role)], framing)

    return Sample(row["sample"], views("context_"), views("target_") if targets else ())
