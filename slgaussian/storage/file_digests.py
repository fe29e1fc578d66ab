"""Digests of files that are large or remote, remembered by a store."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import fsspec
from fsspec.implementations.local import LocalFileSystem

from slgaussian.errors import InputError, SpecError
from slgaussian.io import file_stamp
from slgaussian.storage.remote import explain_error, file_system_errors
from slgaussian.storage.store import ArtifactStore

VERSION_FIELDS = ("mtime", "LastModified", "Last-Modified", "ETag", "Content-MD5", "created")
"""Fields of fsspec's file info that identify the version of a file."""


def read_digest(store: ArtifactStore, file: str) -> str:
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
