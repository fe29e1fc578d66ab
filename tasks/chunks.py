"""Chunks as inputs of stages: known by content, and read through one door."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass
from typing import Any

import fsspec
from fsspec.implementations.local import LocalFileSystem

from slgaussian.datasets import re10k
from slgaussian.errors import InputError, SpecError
from slgaussian.parts.identity import CHANGED, KnownFile, file_stamp
from slgaussian.storage.remote import explained, troubles
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.context import RunContext

STAMPS = ("mtime", "LastModified", "last_modified", "ETag", "etag", "created")
"""Where file systems of fsspec say which version of a file it is."""


def digest_of(store: ArtifactStore, file: str) -> str:
    """SHA-256 of a file's content, hexadecimal, read once for each path, size and time stamp.

    The store remembers it under ``digests/``; a file that was changed within the last
    :data:`slgaussian.parts.identity.SETTLED` seconds, or has no time stamp, is read every time.

    Parameters
    ----------
    store : ArtifactStore
    file : path or fsspec URL

    Raises
    ------
    InputError
        If the file cannot be read or the store not written.
    """
    fs, path = fsspec.core.url_to_fs(os.fspath(file))
    try:
        stamp = _stamp(fs, path)
        name = fs.unstrip_protocol(path)  # whole, so that no other folder has the same
        known = {"path": name, "stamp": stamp}
        uri = f"digests/{hashlib.sha256(name.encode()).hexdigest()}.json"
        remembered = _remembered(store, uri)
        if stamp is not None and remembered.items() >= known.items():
            return remembered["sha256"]
        with fs.open(path, "rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    except troubles() as error:
        raise InputError(f"{file}: cannot be read ({explained(error, path)})") from error
    if stamp is not None:
        store.write(uri, json.dumps({**known, "sha256": digest}).encode())
    return digest


def _stamp(fs: fsspec.AbstractFileSystem, path: str) -> list[Any] | None:
    """Numbers and texts that change whenever a file does; None if nothing tells that it did."""
    if isinstance(fs, LocalFileSystem):
        local = file_stamp(path)
        return None if local is None else list(local)
    info = fs.info(path)
    stamps = [str(info[name]) for name in STAMPS if info.get(name) is not None]
    return [info.get("size"), *stamps] if stamps else None


def _remembered(store: ArtifactStore, uri: str) -> dict[str, Any]:
    try:
        found = json.loads(store.read(uri))
    except (SpecError, ValueError):
        return {}
    return found if isinstance(found, dict) and "sha256" in found else {}


def known_chunk(store: ArtifactStore, file: str) -> KnownFile:
    """A chunk, known by what is in it; InputError as :func:`digest_of`."""
    return KnownFile(file, digest_of(store, file))


def read_chunk(run: RunContext, chunk: KnownFile | ArtifactRef) -> dict[str, re10k.Clip]:
    """The clips of a chunk by key, read once however many stages ask for them.

    The chunk is a file from outside, or in the store (spec ``packed``).

    Raises
    ------
    InputError
        If it cannot be read, two clips have one key, or it is no longer as it was known.
    """

    if isinstance(chunk, ArtifactRef):
        return run.once((re10k.Clip, chunk.digest), lambda: _packed(run.store, chunk))

    def read() -> dict[str, re10k.Clip]:
        clips: dict[str, re10k.Clip] = {}
        for clip in re10k.read_chunk(chunk.place):
            if clip.key in clips:
                raise InputError(
                    f"{chunk.place}: two clips have the key {clip.key!r}; give them their own"
                )
            clips[clip.key] = clip
        if digest_of(run.store, chunk.place) != chunk.digest:
            raise InputError(f"{chunk.place}: {CHANGED}")
        return clips

    return run.once(chunk, read)


def _packed(store: ArtifactStore, chunk: ArtifactRef) -> dict[str, re10k.Clip]:
    data = store.get(chunk)["torch"].tobytes()
    return {clip.key: clip for clip in re10k.clips_in(data, f"{store.root}/{chunk.uri}")}


@dataclass(frozen=True)
class Framing:
    """How the views of a chunk are brought to one size, and their range of depth.

    Attributes
    ----------
    size : (height, width)
    near, far : float, optional
        Depth range along z in scene units; found from the views where it is None.
    """

    size: tuple[int, int]
    near: float | None = None
    far: float | None = None


def left_out(scene: str, error: InputError) -> dict[str, str]:
    """What ``meta["left_out"]`` of a stage's ref says of an item that it could not do."""
    reason = " ".join(str(error).split())
    return {"scene": scene, "kind": type(error).__name__, "reason": reason}
