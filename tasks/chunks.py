"""Chunks of clips: reading, packing, properties of their views, and selection of samples."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import pyarrow as pa
from fsspec.implementations.local import LocalFileSystem

from slgaussian import datasets
from slgaussian.build import check_cameras
from slgaussian.copies import signature
from slgaussian.datasets import re10k
from slgaussian.datasets.configs import Bounds
from slgaussian.datasets.near_copies import SIGNATURE_SIDE
from slgaussian.datasets.pair_selection import TARGETS, Views, choose
from slgaussian.datasets.recognise import posed_scene, recognise
from slgaussian.datasets.shards import key_of
from slgaussian.datasets.sharpness import blur, exposure, glance
from slgaussian.errors import InputError, SpecError
from slgaussian.formats.resampling import Window
from slgaussian.io import CHANGED_FILE, KnownFile, file_stamp
from slgaussian.predict.distance import typical_depths
from slgaussian.predict.view_graph import select_usable
from slgaussian.scene import Scene, View, fit_size
from slgaussian.storage.remote import explain_error, file_system_errors
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.context import RunContext
from tasks.scene import data_identity, describe_cameras
from tasks.stage import stage

VERSION_FIELDS = ("mtime", "LastModified", "Last-Modified", "ETag", "Content-MD5", "created")
"""Fields of fsspec's file info that identify the version of a file."""


def digest_of(store: ArtifactStore, file: str) -> str:
    """Compute the SHA-256 of a file, hexadecimal, once for each path, size and time stamp.

    The store caches it under ``digests/``. A file that changed within the last
    :data:`slgaussian.io.SETTLING_TIME` seconds, or has no time stamp, is read every time.

    Args:
        file: path or fsspec URL

    Raises:
        InputError: If the file cannot be read or the store not written.
    """
    fs, path = fsspec.core.url_to_fs(os.fspath(file))
    name = fs.unstrip_protocol(path)  # the absolute path, which is unique
    uri = f"digests/{hashlib.sha256(name.encode()).hexdigest()}.json"
    try:
        local = isinstance(fs, LocalFileSystem)
        stamp: Sequence[Any] | None = file_stamp(path) if local else _remote_stamp(fs, path)
        identity = {"path": name, "stamp": stamp and list(stamp)}
        with suppress(SpecError, ValueError, AttributeError):
            cached = json.loads(store.read(uri)) if stamp else {}
            if cached.items() >= identity.items():
                return cached["sha256"]
        with fs.open(path, "rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    except file_system_errors() as error:
        raise InputError(f"{file}: cannot be read ({explain_error(error)})") from error
    if stamp:
        store.write(uri, json.dumps({**identity, "sha256": digest}).encode())
    return digest


def _remote_stamp(fs: fsspec.AbstractFileSystem, path: str) -> list[str] | None:
    """Return the version of a file, which ``fs.ukey`` lacks over HTTP; None without one."""
    info = fs.info(path)
    stamps = [str(info[name]) for name in VERSION_FIELDS if info.get(name)]
    return [str(info.get("size")), *stamps] if stamps else None


def known_chunk(store: ArtifactStore, file: str) -> KnownFile:
    """Return a chunk with the digest of its content; InputError as :func:`digest_of`."""
    return KnownFile(file, digest_of(store, file))


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
        if digest_of(run.store, chunk.place) != chunk.digest:
            raise InputError(f"{chunk.place}: {CHANGED_FILE}")
        return clips

    return run.once((re10k.Clip, chunk.digest), read)


def packed_clips(store: ArtifactStore, chunk: ArtifactRef) -> dict[str, re10k.Clip]:
    """Read the clips of an artifact of spec ``packed``, by key."""
    data = store.get(chunk)["torch"].tobytes()
    return {clip.key: clip for clip in re10k.clips_in(data, f"{store.root}/{chunk.uri}")}


@dataclass(frozen=True)
class Framing:
    """Common size and depth range of the views of a chunk.

    Attributes:
        size: (height, width)
        near, far: Depth range along z in scene units; estimated from the views if None.
    """

    size: tuple[int, int]
    near: float | None = None
    far: float | None = None


def framed_views(clip: re10k.Clip, frames: Sequence[int], framing: Framing) -> tuple[View, ...]:
    """Decode and resize frames of a clip; InputError if one cannot be decoded."""
    height, width = framing.size
    resized = [clip.view(frame).resized(height, width) for frame in frames]
    return tuple(replace(v, camera=v.camera.ranged(framing.near, framing.far)) for v in resized)


def left_out(scene: str, error: InputError) -> dict[str, str]:
    """Return the entry of ``meta["left_out"]`` of a stage for an item that failed."""
    reason = " ".join(str(error).split())
    return {"scene": scene, "kind": type(error).__name__, "reason": reason}


@dataclass(frozen=True)
class PosedFolder:
    """A folder or file with the cameras of one scene, or with photographs alone.

    Attributes:
        name: Name of its clip.
    """

    name: str
    path: Path

    def identity(self) -> dict[str, Any]:
        """Return the identity for cache keys: the name, and digests of the files."""
        format, place = recognise(self.path)
        if format == "photographs":  # camera estimation is slow
            inputs = data_identity(datasets.inputs(format, place, ())[0], {}, place)
        else:
            scene, _ = posed_scene(self.path)
            files = [file for name in scene.cameras for file in scene.sources(name)]
            inputs = data_identity(dict.fromkeys(files), scene.cameras, place)
        return {"name": self.name, "format": format, **inputs}

    def scene(self) -> Scene:
        """Read the scene; InputError if there is none."""
        return replace(posed_scene(self.path)[0], name=self.name)


@dataclass(frozen=True)
class Room:
    """A procedural room, by options of the format ``procedural``."""

    name: str
    options: Mapping[str, Any]

    def scene(self) -> Scene:
        """Generate the room."""
        return replace(datasets.load("procedural", **self.options), name=self.name)


@stage("packed", version=4)  # increase it also when camera estimation changes
def packed(run: RunContext, source: PosedFolder | Room, trust_cameras: bool = False) -> ArtifactRef:
    """Pack the scene of a source as a chunk of one clip: spec ``packed``.

    ``meta["cameras"]`` describes the origin of its cameras; ``meta["left_out"]`` lists photographs
    that could not be read or used. Given cameras are checked as those of a field.

    Raises:
        InputError: As :func:`slgaussian.build.check_cameras`, and if no photograph can be read.
    """
    scene, shrunk = source.scene(), dict[str, View]()

    def read(name: str) -> View:
        view = scene.read(name)
        height, width = view.image.shape[:2]
        shrunk[name] = view.resized(*fit_size(height, width, "auto"))
        return view

    errors: list[InputError] = []
    clip = re10k.clip_of(replace(scene, read=read), errors.append)
    unused = dict(scene.estimation.get("left_out", {}))
    if isinstance(source, PosedFolder) and not scene.estimation and len(shrunk) > 1:
        sample = replace(scene, read=shrunk.__getitem__).sample(list(shrunk))
        sample, graph, useless = select_usable(sample)
        check_cameras(sample, graph, trust_cameras)
        if useless:
            names = [view.name for view in sample.context]
            clip = re10k.clip_of(replace(scene, cameras={n: scene.cameras[n] for n in names}))
            unused |= useless
    errors += [InputError(f"{name}: {reason}") for name, reason in unused.items()]
    bad = [left_out(source.name, error) for error in errors]
    data = np.frombuffer(re10k.encoded([clip]), np.uint8)
    meta = {"cameras": describe_cameras(scene.cameras.values()), "left_out": bad}
    return run.store.put("packed", {"torch": data}, meta)


CAMERA_COLUMNS = ("fx", "fy", "cx", "cy", *(f"w2c_{r}{c}" for r in range(3) for c in range(4)))
"""Columns of a camera in the table: a row of a chunk without its two zeros."""


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
        clip_rows, errors = _views(clip)
        if not clip_rows:
            none = f"clip {clip.key!r}: none of its {len(clip.images)} frames can be used"
            errors.append(InputError(none))
        rows += clip_rows
        bad += [left_out(clip.key, error) for error in errors]
    table = pa.Table.from_pylist(rows, schema=load_spec("views").schema)
    return run.store.put("views", table, {"clips": len(clips), "views": len(rows), "left_out": bad})


def _views(clip: re10k.Clip) -> tuple[list[dict[str, Any]], list[InputError]]:
    rows, errors, greys, cameras = [], [], [], []
    for frame, (data, numbers) in enumerate(zip(clip.images, clip.cameras, strict=True)):
        try:
            grey, (width, height) = glance(data)
            camera, opaque = re10k.camera_of(numbers, width, height), clip.opaque(frame)
            shown = grey
            if opaque is not None:
                shown = grey[Window.whole(width, height).mask(opaque, *grey.shape)]
            if not shown.size:
                raise InputError("it is transparent everywhere")
        except InputError as error:
            errors.append(InputError(f"clip {clip.key!r}, frame {frame}: {error}"))
            continue
        mean, clipped = exposure(shown)
        greys.append(grey)
        cameras.append(camera.resized(*grey.shape[::-1]))
        rows.append(
            {
                "clip": clip.key,
                "video": clip.url,
                "frame": frame,
                "timestamp": int(clip.timestamps[frame]),
                "digest": hashlib.sha256(data).hexdigest(),
                "signature": signature(grey, SIGNATURE_SIDE).astype(np.uint8).tobytes().hex(),
                "width": width,
                "height": height,
                **dict(zip(CAMERA_COLUMNS, np.delete(numbers, (4, 5)).tolist(), strict=True)),
                "blur": blur(grey),
                "mean": mean,
                "clipped": clipped,
            }
        )
    for row, depth in zip(rows, typical_depths(greys, cameras).tolist(), strict=True):
        row["depth"] = None if np.isnan(depth) else depth
    return rows, errors


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
    table = pa.Table.from_pylist(rows, schema=load_spec("pairs").schema)
    return run.store.put("pairs", table, {"samples": len(rows), "left_out": bad})


def known_views(views: Sequence[Mapping[str, Any]]) -> Views:
    """Convert rows of spec ``views`` of one clip to :class:`Views`."""

    def column(name: str) -> np.ndarray:
        return np.array([view[name] for view in views], np.float64)

    numbers = np.insert(
        [[view[name] for name in CAMERA_COLUMNS] for view in views], (4, 4), 0, axis=1
    )
    cameras = [
        re10k.camera_of(row, view["width"], view["height"])
        for row, view in zip(numbers, views, strict=True)
    ]
    return Views(cameras, column("depth"), column("blur"), column("mean"), column("clipped"))
