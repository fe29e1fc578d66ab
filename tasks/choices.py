"""Which views of each clip of a chunk make a sample of a training set."""

from __future__ import annotations

from itertools import groupby
from typing import Any

import pyarrow as pa

from slgaussian.datasets.pair_selection import Bounds, choose
from slgaussian.datasets.shards import key_of
from slgaussian.errors import InputError
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef
from tasks.chunks import known_views, left_out
from tasks.context import RunContext
from tasks.stage import stage


@stage("choices", version=1)
def choices(run: RunContext, views: ArtifactRef, bounds: Bounds, targets: int) -> ArtifactRef:
    """Samples with so many targets of the clips of a chunk: spec ``choices``.

    As :func:`tasks.chunks.pairs`, whose samples have three. A clip that has no sample is named in
    ``meta["left_out"]``.
    """
    rows: list[dict[str, Any]] = []
    bad: list[dict[str, str]] = []
    for clip, group in groupby(run.store.get(views).to_pylist(), key=lambda row: row["clip"]):
        own = list(group)
        try:
            chosen = choose(known_views(own), bounds, targets)
        except InputError as error:
            bad.append(left_out(clip, InputError(f"clip {clip!r}: {error}")))
            continue
        for pair in chosen:
            taken = [own[i] for i in (*pair.context, *pair.targets)]
            frames = [view["frame"] for view in taken]
            rows.append(
                {
                    "sample": f"{key_of(clip)}_{frames[0]:04d}_{frames[1]:04d}",
                    "clip": clip,
                    "context": frames[:2],
                    "targets": frames[2:],
                    "overlap": pair.overlap,
                    "baseline": pair.baseline,
                    "depth": pair.depth,
                    "score": pair.score,
                    "blur": max(view["blur"] for view in taken),
                    "clipped": max(view["clipped"] for view in taken),
                }
            )
    table = pa.Table.from_pylist(rows, schema=load_spec("choices").schema)
    return run.store.put("choices", table, {"samples": len(rows), "left_out": bad})
