"""Copies of a remote store's files on the local disk, no more of them than a bound allows.

fsspec's own ``filecache`` has no bound, and keeps an index of all copies that processes which share
the folder write over each other.
"""

from __future__ import annotations

import io
import os
import time
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

ABANDONED = 3600.0
"""Seconds after which an unfinished copy is taken for that of a process that was killed."""


@dataclass
class LocalCache:
    """Files by their path in the store, which names their content: a copy is never out of date.

    Any number of processes may share the folder. Each looks at the whole of it after every
    sixteenth of the bound that it wrote itself, and then removes what was not used for longest down
    to seven eighths; so with up to two processes it stays below the bound, and goes above by at
    most a sixteenth for each further one. What cannot be read or written is left out: this is only
    an aid.

    Attributes
    ----------
    folder : path
    bound : int
        Bytes. Files of more than an eighth of it are not kept.
    """

    folder: Path
    bound: int
    _written: int | None = field(default=None, repr=False)

    @classmethod
    def from_environment(cls) -> LocalCache | None:
        """Return the one of ``SLGAUSSIAN_CACHE`` and ``SLGAUSSIAN_CACHE_SIZE``; None of size 0.

        By default the folder ``slgaussian/objects`` of the user's cache, and
        :data:`DEFAULT_BOUND`.
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
            os.utime(path)  # the time of its last use
        except OSError:
            return None
        return data

    def put(self, uri: str, data: bytes) -> None:
        """Keep a copy of the file at ``uri``."""
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
        """Keep no copy of the file at ``uri``."""
        with suppress(OSError):
            (self.folder / uri).unlink()

    def _make_room(self, size: int) -> None:
        files = []
        for folder, _, names in os.walk(self.folder):
            for path in (Path(folder, name) for name in names):
                with suppress(OSError):  # gone meanwhile
                    state = path.lstat()
                    files.append((state.st_mtime, state.st_size, path))
        total = size + sum(length for _, length, _ in files)
        for used, length, path in sorted(files):
            is_unfinished = path.suffix == ".tmp"
            abandoned = is_unfinished and time.time() - used > ABANDONED
            if abandoned or (total > self.bound * 7 // 8 and not is_unfinished):
                with suppress(OSError):
                    path.unlink()
                total -= length
        self._written = 0


def kept_arrays(uri: str, make: Callable[[], Mapping[str, np.ndarray]]) -> Mapping[str, np.ndarray]:
    """Return arrays by name as ``make`` makes them, once: they are kept in the user's cache.

    ``uri`` names all that they depend on. What is kept in a damaged file is made anew.
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
    """Return the folder of this program in the user's cache: ``$XDG_CACHE_HOME``, ``~/.cache``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "slgaussian"
