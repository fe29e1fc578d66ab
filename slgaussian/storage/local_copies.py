"""Copies of a remote store's files on the local disk, no more of them than a bound allows."""

from __future__ import annotations

import io
import os
import re
import time
import uuid
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from slgaussian.errors import InputError

DEFAULT_BOUND = "10 GB"
_UNITS = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}

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
        """The one of ``SLGAUSSIAN_CACHE`` and ``SLGAUSSIAN_CACHE_SIZE``; None for a size of 0.

        By default the folder ``slgaussian/objects`` of the user's cache, and
        :data:`DEFAULT_BOUND`.
        """
        bound = parse_size(os.environ.get("SLGAUSSIAN_CACHE_SIZE") or DEFAULT_BOUND)
        folder = os.environ.get("SLGAUSSIAN_CACHE") or user_cache() / "objects"
        return cls(Path(folder), bound) if bound else None

    def get(self, uri: str) -> bytes | None:
        """The file at ``uri``, or None if there is no copy."""
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
        unfinished = path.with_name(f".{uuid.uuid4().hex}.tmp")
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            unfinished.write_bytes(data)
            unfinished.replace(path)
            self._written = (self._written or 0) + len(data)

    def drop(self, uri: str) -> None:
        """Keep no copy of the file at ``uri``."""
        with suppress(OSError):
            (self.folder / uri).unlink()

    def _make_room(self, size: int) -> None:
        files = sorted(_files_below(self.folder), key=lambda file: file[0])
        total = size + sum(length for _, length, _ in files)
        fits = self.bound * 7 // 8
        for used, length, path in files:
            abandoned = path.endswith(".tmp") and time.time() - used > ABANDONED
            if abandoned or (total > fits and not path.endswith(".tmp")):
                with suppress(OSError):
                    os.unlink(path)
                total -= length
        self._written = 0


def kept_arrays(uri: str, make: Callable[[], Mapping[str, np.ndarray]]) -> Mapping[str, np.ndarray]:
    """Arrays by name as ``make`` makes them, or as it did before: kept in the user's cache.

    ``uri`` names all that they depend on. What is kept in a damaged file is made anew.
    """
    cache = LocalCache.from_environment()
    if cache is None:
        return make()
    data = cache.get(uri)
    if data is not None:
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as kept:
                return dict(kept)
        except (ValueError, OSError, EOFError, zipfile.BadZipFile):
            cache.drop(uri)
    arrays = make()
    packed = io.BytesIO()
    np.savez(packed, allow_pickle=False, **arrays)
    cache.put(uri, packed.getvalue())
    return arrays


def user_cache() -> Path:
    """The folder of this program in the user's cache: ``$XDG_CACHE_HOME``, or ``~/.cache``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "slgaussian"


def parse_size(text: str) -> int:
    """Bytes of a text such as ``10 GB``, ``500M`` or ``0``; InputError if it is none."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?)B?\s*", text, re.IGNORECASE)
    if not found:
        raise InputError(f"SLGAUSSIAN_CACHE_SIZE: found {text!r}, expected a size such as '10 GB'")
    return int(float(found[1]) * _UNITS[found[2].upper()])


def _files_below(folder: str | os.PathLike[str]) -> Iterator[tuple[float, int, str]]:
    """Time of last use, size and path of every file that is still there when looked at."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                yield from _files_below(entry.path)
                continue
            with suppress(OSError):
                found = entry.stat(follow_symlinks=False)
                yield found.st_mtime, found.st_size, entry.path
