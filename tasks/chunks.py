"""Chunks of clips: reading, packing, properties of their views, and selection of samples."""

from __future__ import annotations

from itertools import groupby
from typing import Any

import numpy as np
import pyarrow as pa

from slgaussian.build import make_clip
from slgaussian.cameras.estimated import describe_cameras
from slgaussian.datasets import re10k
from slgaussian.datasets.clip_views import describe_views, known_views
from slgaussian.datasets.configs import Bounds
from slgaussian.datasets.pair_selection import TARGETS, choose
from slgaussian.datasets.shards import make_key
from slgaussian.datasets.sources import PosedFolder, Room
from slgaussian.errors import InputError
from slgaussian.io import CHANGED_FILE, KnownFile
from slgaussian.storage.file_digests import read_digest
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.context import RunContext
from tasks.stage import stage


def known_chunk(store: ArtifactStore, file: str) -> KnownFile:
    """Return a chunk with the digest of its content; InputError as :func:`read_digest`."""
    return KnownFile(file, read_digest(store, file))


def read_chunk(run: RunContext, chunk: KnownFile | ArtifactRef) -> dict[str, re10k.Clip]:
    """Read the clips of a chunk by key, once for all stages.

    The chunk is an external file, or an artifact of spec ``packed``.

    Raises:
        InputError: If it cannot be read, two clips have one key, or its content has changed.
    """

    def read() -> dict[str, re10k.Clip]:
        if isinstance(chunk, ArtifactRef):
            return packed_clips(run.store, chunk)
        clips: dict[str, re10k.Clip] = {}
        for clip in re10k.read_chunk(chunk.place):
            if clip.key in clips:
                raise InputError(
                    f"{chunk.place}: two clips have the key {clip.key!r}; give them different keys"
                )
            clips[clip.key] = clip
        if read_digest(run.store, chunk.place) != chunk.digest:
            raise InputError(f"{chunk.place}: {CHANGED_FILE}")
        return clips

    return run.once((re10k.Clip, chunk.digest), read)


def packed_clips(store: ArtifactStore, chunk: ArtifactRef) -> dict[str, re10k.Clip]:
    """Read the clips of an artifact of spec ``packed``, by key."""
    data = store.get(chunk)["torch"].tobytes()
    return {clip.key: clip for clip in re10k.clips_in(data, f"{store.root}/{chunk.uri}")}


def left_out(scene: str, error: InputError) -> dict[str, str]:
    """Return the entry of ``meta["left_out"]`` of a stage for an item that failed."""
    reason = " ".join(str(error).split())
    return {"scene": scene, "kind": type(error).__name__, "reason": reason}


@stage("packed", version=4)  # increase it also when camera estimation changes
def packed(run: RunContext, source: PosedFolder | Room, trust_cameras: bool = False) -> ArtifactRef:
    """Pack the scene of a source as a chunk of one clip: spec ``packed``.

    ``meta["cameras"]`` describes the origin of its cameras; ``meta["left_out"]`` lists photographs
    that could not be read or used. Given cameras are checked as those of a field.

    Raises:
        InputError: As :func:`slgaussian.build.check_cameras`, and if no photograph can be read.
    """
    scene = source.scene()
    clip, errors = make_clip(scene, isinstance(source, PosedFolder), trust_cameras)
    bad = [left_out(source.name, error) for error in errors]
    data = np.frombuffer(re10k.encode_chunk([clip]), np.uint8)
    meta = {"cameras": describe_cameras(scene.cameras.values()), "left_out": bad}
    return run.store.put("packed", {"torch": data}, meta)


@stage("views", version=4)
def views(run: RunContext, chunk: KnownFile | ArtifactRef) -> ArtifactRef:
    """Compute the properties of all views of a chunk: spec ``views``.

    ``meta["left_out"]`` lists frames that cannot be decoded or have an invalid pose, and clips
    without valid frames.
    """
    rows: list[dict[str, Any]] = []
    bad: list[dict[str, str]] = []
    clips = read_chunk(run, chunk)
    for clip in clips.values():
        clip_rows, errors = describe_views(clip)
        if not clip_rows:
            none = f"clip {clip.key!r}: none of its {len(clip.images)} frames can be used"
            errors.append(InputError(none))
        rows += clip_rows
        bad += [left_out(clip.key, error) for error in errors]
    table = pa.Table.from_pylist(rows, schema=load_spec("views").schema)
    return run.store.put("views", table, {"clips": len(clips), "views": len(rows), "left_out": bad})


@stage("pairs", version=2)
def pairs(
    run: RunContext, views: ArtifactRef, bounds: Bounds, targets: int = TARGETS
) -> ArtifactRef:
    """Choose samples with ``targets`` target views from the clips of a chunk: spec ``pairs``.

    Photographs are not read again. ``meta["left_out"]`` lists clips without a sample.
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
                    "sample": f"{make_key(clip)}_{frames[0]:04d}_{frames[1]:04d}",
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
    table = pa.Table.from_pylist(rows, schema=load_spec("pairs").schema)
    return run.store.put("pairs", table, {"samples": len(rows), "left_out": bad})
