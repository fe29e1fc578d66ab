"""Selection of the views of each clip of a chunk that form samples of a training set."""

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
    """Choose samples with ``targets`` target views from the clips of a chunk: spec ``choices``.

    As :func:`tasks.chunks.pairs`, whose samples have three targets. ``meta["left_out"]`` lists
    clips without a sample.
    """
    rows: list[dict[str, Any]] = []
    bad: list[dict[str, str]] = []
    for clip, group in groupby(run.store.get(views).to_pylist(), key=lambda row: row["clip"]):
        clip_views = list(group)
        try:
            chosen = choose(known_views(clip_views), bounds, targets)
        except InputError as error:
            bad.append(left_out(clip, InputError(f"clip {clip!r}: {error}")))
            continue
        for pair in chosen:
            selected = [clip_views[i] for i in (*pair.context, *pair.targets)]
            frames = [view["frame"] for view in selected]
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
                    "blur": max(view["blur"] for view in selected),
                    "clipped": max(view["clipped"] for view in selected),
                }
            )
    table = pa.Table.from_pylist(rows, schema=load_spec("choices").schema)
    return run.store.put("choices", table, {"samples": len(rows), "left_out": bad})
