"""Atomic writes, lines and digests of files, short reprs; imported by all other packages."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

from slgaussian.errors import InputError

MAX_SHOWN_ENTRIES = 4
"""Largest number of entries of a collection that a repr shows; it counts the others."""

Digest = Callable[[str | Path], str]
"""Computes the SHA-256, hexadecimal, of the file, folder or model at a place."""


def write_atomic(
    path: str | os.PathLike[str], data: bytes | memoryview, sync: bool = False
) -> None:
    """Write a local file atomically: readers see the complete file or none, also after a crash.

    With ``sync``, also after a crash of the machine, as the data are flushed to the disk.
    """
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        file.write(data)
        if sync:
            file.flush()
            os.fsync(file.fileno())


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[str]:
    """Yield the name of a temporary file, which replaces ``path`` when the block ends."""
    folder, name = os.path.split(os.fspath(path))
    temporary = os.path.join(folder, f".{name}.{uuid.uuid4().hex[:8]}.tmp")
    try:
        yield temporary
        os.replace(temporary, path)
    except BaseException:
        if os.path.exists(temporary):
            os.remove(temporary)
        raise


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder, which replaces the folder ``path`` when the block ends.

    Raises:
        InputError: If it cannot be written; ``path`` is then unchanged.
    """
    with explain_write_errors(path):
        draft = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
        try:
            draft.chmod(0o755)
            yield draft
            if path.exists():
                os.rename(path, old := Path(f"{draft}-old"))
                os.rename(draft, path)
                shutil.rmtree(old)
            else:
                os.rename(draft, path)
        except BaseException:
            shutil.rmtree(draft, ignore_errors=True)
            raise


@contextmanager
def explain_write_errors(path: Path) -> Iterator[None]:
    """Raise an OSError of the block as an InputError that says what to do about ``path``."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); choose a folder that you may write "
            "to, on a disk with room"
        ) from error


def file_sha256(file: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a local file's content, hexadecimal; OSError if it cannot be read."""
    with open(file, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


CHANGED_FILE = "was changed after the run had begun; start the run again"
"""Message about a file whose content changed during a run."""

SETTLING_TIME = 2.0
"""Seconds after which a file's time stamps are a reliable sign of changes: file systems have a
time resolution of up to 2 s, and a file may be written twice within it."""


@dataclass(frozen=True)
class KnownFile:
    """An external file, folder or model, identified by its content.

    Attributes:
        place: Absolute path, or a name on the Hugging Face hub.
        digest: SHA-256 of its content, hexadecimal; None if any content is accepted.
    """

    place: str
    digest: str | None

    @staticmethod
    def at(place: str | Path, digest_of: Digest) -> KnownFile:
        """Return the file at a place with its current digest; raises as ``digest_of``."""
        path = Path(place)
        resolved = str(path.resolve() if path.exists() else path)
        return KnownFile(resolved, digest_of(resolved))

    def checked(self, name: str, digest_of: Digest, otherwise: str = CHANGED_FILE) -> str:
        """Check that the content is unchanged, and return the place.

        Raises:
            InputError: If the content cannot be read or has changed. The message begins with
                ``name`` and the place, and ends with ``otherwise`` for changed content.
        """
        try:
            same = self.digest is None or digest_of(self.place) == self.digest
        except OSError as error:
            raise InputError(f"{name} {self.place}: cannot be read ({error.strerror})") from error
        if not same:
            raise InputError(f"{name} {self.place}: {otherwise}")
        return self.place


def file_digest(place: str | Path) -> str:
    """Return the SHA-256 of a file, hexadecimal; OSError if it cannot be read.

    The file is read once for each :func:`file_stamp`, as it may be large and shared by many scenes.
    """
    file = Path(place).resolve()
    stamp = file_stamp(file)
    return file_sha256(file) if stamp is None else _hash_file(file, stamp)


def file_stamp(file: str | Path) -> tuple[int, ...] | None:
    """Return numbers that change whenever a local file's content does; OSError if it is missing.

    They include the inode change time, which programs that copy or unpack files cannot set back,
    unlike the modification time. None within :data:`SETTLING_TIME` seconds of a change.
    """
    state = os.stat(file)
    if time.time() - state.st_mtime < SETTLING_TIME:
        return None
    return state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns


@lru_cache(maxsize=1024)
def _hash_file(file: Path, stamp: tuple[int, ...]) -> str:
    return file_sha256(file)


def write_file(path: str | Path, data: bytes | memoryview) -> None:
    """Write ``data`` to ``path`` atomically, replacing an existing file.

    InputError if the file cannot be written.
    """
    try:
        write_atomic(path, data)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); name a file in a folder that exists "
            "and that you may write to"
        ) from error


def read_lines(file: str | Path) -> list[str]:
    """Read the lines of a file, separated by LF or CR LF.

    Other characters at which :meth:`str.splitlines` splits (U+2028, U+0085, form feed) may be part
    of names.

    Raises:
        OSError, UnicodeDecodeError: If it cannot be read, or is not valid UTF-8.
    """
    text = Path(file).read_bytes().decode("utf-8-sig")
    return [line.removesuffix("\r") for line in text.split("\n")]


def short_repr(self: Any) -> str:
    """Return a ``repr`` of a dataclass with shapes of arrays, and without fields that are None.

    >>> import numpy as np
    >>> from slgaussian.labels import LabelMaps
    >>> LabelMaps(np.zeros((2, 3, 4), np.int32), np.zeros((2, 3, 4), np.float32))
    LabelMaps(labels=int32 [2, 3, 4], margin=float32 [2, 3, 4])
    """
    values = ((f, getattr(self, f.name)) for f in fields(self) if f.repr)
    entries = [f"{f.name}={short(value)}" for f, value in values if value is not None or f.default]
    return f"{type(self).__name__}({', '.join(entries)})"


def short(value: Any) -> str:
    """Return a short text of a value: dtype and shape of arrays, first entries of collections."""
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"{str(value.dtype).removeprefix('torch.')} {list(value.shape)}"
    if isinstance(value, Mapping):
        plain = all(isinstance(item, (str, int, float)) for item in value.values())
        entries = (f"{key!r}: {item!r}" if plain else repr(key) for key, item in value.items())
        return f"{{{_join_entries(entries, len(value))}}}"
    if isinstance(value, (tuple, list)):
        names = (repr(getattr(item, "name", item)) for item in value)
        return f"({_join_entries(names, len(value))})"
    return value.__qualname__ if hasattr(value, "__qualname__") else repr(value)


def _join_entries(texts: Iterable[str], count: int) -> str:
    entries = [text for text, _ in zip(texts, range(MAX_SHOWN_ENTRIES), strict=False)]
    return ", ".join(
        [*entries, f"and {count - MAX_SHOWN_ENTRIES} more"]
        if count > MAX_SHOWN_ENTRIES
        else entries
    )
