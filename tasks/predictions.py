"""Prediction of Gaussians for all samples of a chunk, the slow step, independent of masks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pyarrow as pa

from slgaussian.components.component import Component
from slgaussian.datasets.re10k import Clip
from slgaussian.errors import InputError
from slgaussian.io import KnownFile
from slgaussian.scene import Sample
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef
from tasks.chunks import Framing, framed_views, left_out, read_chunk
from tasks.context import RunContext
from tasks.scene import geometry
from tasks.stage import stage


# Its version depends on that of the stage for a single scene.
@stage("predictions", version=1000 * geometry.version + 1)
def predictions(
    run: RunContext,
    pairs: ArtifactRef,
    chunk: KnownFile | ArtifactRef,
    framing: Framing,
    predictor: Component,
    seed: int,
) -> ArtifactRef:
    """Predict the Gaussians of the samples of a chunk: spec ``predictions``.

    ``meta["left_out"]`` lists samples that failed.
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
        entry = {"sample": row["sample"], "uri": ref.uri, "digest": ref.digest}
        rows.append({**entry, "gaussians": len(gaussians)})
    table = pa.Table.from_pylist(rows, schema=load_spec("predictions").schema)
    parts = [row["uri"] for row in rows]
    meta = {"samples": len(rows), "left_out": bad, "parts": parts}
    return store.put("predictions", table, meta)


def read_sample(clip: Clip, row: Mapping[str, Any], framing: Framing, targets: bool) -> Sample:
    """Read the sample of a row of spec ``pairs`` at the common size.

    Decoding ``targets`` takes as long as the context and is optional.

    Raises:
        InputError: If a view cannot be decoded, or the views do not make a sample.
    """

    context = framed_views(clip, row["context"], framing)
    target_views = framed_views(clip, row["targets"], framing) if targets else ()
    return Sample(row["sample"], context, target_views)
