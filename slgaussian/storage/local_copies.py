"""Local disk cache of a remote store's files, with a bound on its size.

fsspec's ``filecache`` has no bound, and processes that share its folder overwrite each other's
index.
"""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydantic import ByteSize, TypeAdapter, ValidationError

from slgaussian.errors import InputError
from slgaussian.io import write_atomic

DEFAULT_BOUND = "10 GB"


@dataclass
class LocalCache:
    """Files by their path in the store, which contains their digest, so copies are never stale.

    Several processes may share the folder. Whenever a process has written a sixteenth of the bound,
    it scans the folder and removes the least recently used files until seven eighths of the bound
    are left. Two processes thus stay below the bound, and each further process may exceed it by a
    sixteenth. Files that cannot be read or written are skipped.

    Attributes:
        bound: Bytes. Files larger than an eighth of it are not cached.
    """

    folder: Path
    bound: int
    _written: int | None = field(default=None, repr=False)

    @classmethod
    def from_environment(cls) -> LocalCache | None:
        """Return the cache of ``SLGAUSSIAN_CACHE`` and ``SLGAUSSIAN_CACHE_SIZE``; None for size 0.

        Defaults: the folder ``slgaussian/objects`` of the user's cache, and :data:`DEFAULT_BOUND`.
        """
        text = os.environ.get("SLGAUSSIAN_CACHE_SIZE") or DEFAULT_BOUND
        try:
            bound = TypeAdapter(ByteSize).validate_python(text.strip())
        except ValidationError:
            raise InputError(
                f"SLGAUSSIAN_CACHE_SIZE: found {text!r}, expected a size such as '10 GB'"
            ) from None
        folder = os.environ.get("SLGAUSSIAN_CACHE") or user_cache() / "objects"
        return cls(Path(folder), bound) if bound else None

    def get(self, uri: str) -> bytes | None:
        """Return the file at ``uri``, or None if there is no copy."""
        path = self.folder / uri
        try:
            data = path.read_bytes()
            os.utime(path)  # time of last use
        except OSError:
            return None
        return data

    def put(self, uri: str, data: bytes) -> None:
        """Store a copy of the file at ``uri``."""
        if len(data) > self.bound // 8:
            return
        if self._written is None or self._written + len(data) > self.bound // 16:
            self._make_room(len(data))
        path = self.folder / uri
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(path, data)
            self._written = (self._written or 0) + len(data)

    def drop(self, uri: str) -> None:
        """Remove the copy of the file at ``uri``."""
        with suppress(OSError):
            (self.folder / uri).unlink()

    def _make_room(self, size: int) -> None:
        files = []
        for folder, _, names in os.walk(self.folder):
            for path in (Path(folder, name) for name in names):
                with suppress(OSError):  # removed meanwhile
                    state = path.lstat()
                    files.append((state.st_mtime, state.st_size, path))
        total = size + sum(length for _, length, _ in files)
        for _, length, path in sorted(files):
            if total > self.bound * 7 // 8:
                with suppress(OSError):
                    path.unlink()
                total -= length
        self._written = 0


def cached_arrays(
    uri: str, make: Callable[[], Mapping[str, np.ndarray]]
) -> Mapping[str, np.ndarray]:
    """Return the arrays of ``make`` by name, computed once and cached for the user.

    ``uri`` identifies all inputs of the computation. Damaged files are computed again.
    """
    cache = LocalCache.from_environment()
    if cache is None:
        return make()
    data = cache.get(uri)
    if data is not None:
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as stored:
                return dict(stored)
        except (ValueError, OSError, EOFError, zipfile.BadZipFile):
            cache.drop(uri)
    arrays = make()
    packed = io.BytesIO()
    np.savez(packed, allow_pickle=False, **arrays)
    cache.put(uri, packed.getvalue())
    return arrays


def user_cache() -> Path:
    """Return this program's folder in the user's cache, ``$XDG_CACHE_HOME`` or ``~/.cache``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "slgaussian"
