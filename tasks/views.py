"""What is known of every view of a chunk: camera, blur, exposure and how far away things are."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import pyarrow as pa

from slgaussian.datasets import re10k
from slgaussian.datasets.sharpness import blur, exposure, glance
from slgaussian.errors import InputError
from slgaussian.parts.identity import KnownFile
from slgaussian.predict.distance import typical_depths
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef
from tasks.chunks import left_out, read_chunk
from tasks.context import RunContext
from tasks.stage import stage

ROW = ("fx", "fy", "cx", "cy", *(f"w2c_{r}{c}" for r in range(3) for c in range(4)))
"""Columns of the table that hold a camera, as a row of a chunk has it without its two zeros."""


@stage("views", version=1)
def views(run: RunContext, chunk: KnownFile | ArtifactRef) -> ArtifactRef:
    """What is known of all views of a chunk: spec ``views``.

    A frame that cannot be decoded, or whose pose is none, is left out by itself and named in
    ``meta["left_out"]``, as is a clip without any.
    """
    rows: list[dict[str, Any]] = []
    bad: list[dict[str, str]] = []
    clips = read_chunk(run, chunk)
    for clip in clips.values():
        found, failed = _views(clip)
        if not found:
            none = f"clip {clip.key!r}: none of its {len(clip.images)} frames can be used"
            failed.append(left_out(clip.key, InputError(none)))
        rows += found
        bad += failed
    table = pa.Table.from_pylist(rows, schema=load_spec("views").schema)
    return run.store.put("views", table, {"clips": len(clips), "views": len(rows), "left_out": bad})


def _views(clip: re10k.Clip) -> tuple[list[dict[str, Any]], list[dict[str, str]]]:
    rows, bad, greys, cameras = [], [], [], []
    for frame, (data, numbers) in enumerate(zip(clip.images, clip.cameras, strict=True)):
        try:
            grey, (width, height) = glance(data)
            camera = re10k.camera_of(numbers, width, height)
        except InputError as error:
            named = InputError(f"clip {clip.key!r}, frame {frame}: {error}")
            bad.append(left_out(clip.key, named))
            continue
        mean, clipped = exposure(grey)
        greys.append(grey)
        cameras.append(camera.resized(*grey.shape[::-1]))
        rows.append(
            {
                "clip": clip.key,
                "frame": frame,
                "timestamp": int(clip.timestamps[frame]),
                "digest": hashlib.sha256(data).hexdigest(),
                "width": width,
                "height": height,
                **dict(zip(ROW, np.delete(numbers, (4, 5)).tolist(), strict=True)),
                "blur": blur(grey),
                "mean": mean,
                "clipped": clipped,
            }
        )
    for row, depth in zip(rows, typical_depths(greys, cameras).tolist(), strict=True):
        row["depth"] = None if np.isnan(depth) else depth
    return rows, bad
