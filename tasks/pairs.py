"""Which views of each clip of a chunk make a sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np
import pyarrow as pa

from slgaussian.datasets import re10k
from slgaussian.datasets.pair_selection import Bounds, Views, choose
from slgaussian.errors import InputError
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef
from tasks.chunks import left_out
from tasks.context import RunContext
from tasks.stage import stage
from tasks.views import ROW


@stage("pairs", version=1)
def pairs(run: RunContext, views: ArtifactRef, bounds: Bounds) -> ArtifactRef:
    """Samples of the clips of a chunk: spec ``pairs``.

    The photographs are not read again. A clip that has no sample is named in ``meta["left_out"]``.
    """
    rows: list[dict[str, Any]] = []
    bad: list[dict[str, str]] = []
    known = run.store.get(views).to_pylist()
    for clip, own in groupby(known, key=lambda row: row["clip"]):
        try:
            rows += _samples(clip, list(own), bounds)
        except InputError as error:
            bad.append(left_out(clip, InputError(f"clip {clip!r}: {error}")))
    table = pa.Table.from_pylist(rows, schema=load_spec("pairs").schema)
    return run.store.put("pairs", table, {"samples": len(rows), "left_out": bad})


def known_views(views: Sequence[Mapping[str, Any]]) -> Views:
    """What is known of the views of a clip, of rows of spec ``views``."""

    def column(name: str) -> np.ndarray:
        return np.array([view[name] for view in views], np.float64)

    numbers = np.insert([[view[name] for name in ROW] for view in views], (4, 4), 0, axis=1)
    cameras = [
        re10k.camera_of(row, view["width"], view["height"])
        for row, view in zip(numbers, views, strict=True)
    ]
    return Views(cameras, column("depth"), column("blur"), column("mean"), column("clipped"))


def _samples(clip: str, views: list[dict[str, Any]], bounds: Bounds) -> list[dict[str, Any]]:
    frames = [view["frame"] for view in views]
    rows = []
    for pair in choose(known_views(views), bounds):
        context = [frames[i] for i in pair.context]
        targets = [frames[i] for i in pair.targets]
        rows.append(
            {
                "sample": f"{clip}_{context[0]:04d}_{context[1]:04d}",
                "clip": clip,
                "context_0": context[0],
                "context_1": context[1],
                **{f"target_{i}": frame for i, frame in enumerate(targets)},
                "overlap": pair.overlap,
                "baseline": pair.baseline,
                "depth": pair.depth,
                "score": pair.score,
            }
        )
    return rows
