"""Atomic writes, digests of files and short reprs: the ground floor, which anything may import."""

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

FEW = 4
"""Entries of a collection that are printed; of more, how many there are."""

Digest = Callable[[str | Path], str]
"""Computes of a place the SHA-256, hexadecimal, of what is there."""


def write_atomic(
    path: str | os.PathLike[str], data: bytes | memoryview, sync: bool = False, new: bool = False
) -> None:
    """Write a local file so that no reader, and no crash of the program, ever sees a part of it.

    With ``sync``, no crash of the machine either: it is on the disk when this returns. With
    ``new``, FileExistsError if there is one already and the disk knows hard links, which can tell.
    """
    with atomic_path(path, new) as temporary, open(temporary, "wb") as file:
        file.write(data)
        if sync:
            file.flush()
            os.fsync(file.fileno())


@contextmanager
def atomic_path(path: str | os.PathLike[str], new: bool = False) -> Iterator[str]:
    """Yield a name to write a local file under, which replaces ``path`` once it is whole.

    ``new`` as :func:`write_atomic` has it.
    """
    folder, name = os.path.split(os.fspath(path))
    temporary = os.path.join(folder, f".{name}.{uuid.uuid4().hex[:8]}.tmp")
    try:
        yield temporary
        if new:
            try:
                os.link(temporary, path)
            except FileExistsError:
                raise
            except OSError:
                pass  # one that has no links
            else:
                os.remove(temporary)
                return
        os.replace(temporary, path)
    except BaseException:
        if os.path.exists(temporary):
            os.remove(temporary)
        raise


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Yield a folder to fill, which replaces the folder ``path`` once it is whole.

    Raises
    ------
    InputError
        If it cannot be written; what is at ``path`` stays then.
    """
    try:
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
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); choose a folder that you may write "
            "to, on a disk with room"
        ) from error


def file_sha256(file: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a local file's content, hexadecimal; OSError if it cannot be read."""
    with open(file, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


CHANGED = "was changed after the run had begun; start the run again"
"""What is said of a file with another content than a run began with."""

SETTLED = 2.0
"""Seconds after which a file's times tell that it was changed: clocks of file systems tick this
slowly, and a file may be written twice within a tick."""


@dataclass(frozen=True)
class KnownFile:
    """A file, folder or model from outside.

    Attributes
    ----------
    place : str
        Where it is: a path from the root, or a name as on the Hugging Face hub.
    digest : str or None
        SHA-256 of its content, hexadecimal; None if any content will do.
    """

    place: str
    digest: str | None

    @staticmethod
    def at(place: str | Path, digest_of: Digest) -> KnownFile:
        """Return what is at a place now; raises as ``digest_of``."""
        path = Path(place)
        resolved = str(path.resolve() if path.exists() else path)
        return KnownFile(resolved, digest_of(resolved))

    def checked(self, name: str, digest_of: Digest, otherwise: str = CHANGED) -> str:
        """Return the place, at which there still is the same content.

        Raises
        ------
        InputError
            If it cannot be read, or is another one: then ``otherwise`` is said of it. The sentence
            begins with ``name`` and the place.
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

    A file of gigabytes, or one that many scenes share, is read once for each :func:`file_stamp`.
    """
    file = Path(place).resolve()
    stamp = file_stamp(file)
    return file_sha256(file) if stamp is None else _digest_of(file, stamp)


def file_stamp(file: str | Path) -> tuple[int, ...] | None:
    """Return numbers that change whenever a local file's content does; OSError if it is not there.

    The time at which the inode changed is among them: unlike that of the content, no program that
    copies or unpacks files sets it back. None within :data:`SETTLED` seconds of a change.
    """
    state = os.stat(file)
    if time.time() - state.st_mtime < SETTLED:
        return None
    return state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns


@lru_cache(maxsize=1024)
def _digest_of(file: Path, stamp: tuple[int, ...]) -> str:
    return file_sha256(file)


def write_file(path: str | Path, data: bytes | memoryview) -> None:
    """Write ``data`` to ``path``, complete or not at all; a file that is there is replaced.

    InputError if the file cannot be written.
    """
    try:
        write_atomic(path, data)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); name a file in a folder that exists "
            "and that you may write to"
        ) from error


def short_repr(self: Any) -> str:
    """Return a ``repr`` of a dataclass that prints shapes of arrays, and no field that is None.

    >>> import numpy as np
    >>> from slgaussian.labels import LabelMaps
    >>> LabelMaps(np.zeros((2, 3, 4), np.int32), np.zeros((2, 3, 4), np.float32))
    LabelMaps(labels=int32 [2, 3, 4], margin=float32 [2, 3, 4])
    """
    values = ((f, getattr(self, f.name)) for f in fields(self) if f.repr)
    entries = [f"{f.name}={short(value)}" for f, value in values if value is not None or f.default]
    return f"{type(self).__name__}({', '.join(entries)})"


def short(value: Any) -> str:
    """Return a value in a few words: arrays by dtype and shape, the first entries of the rest."""
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"{str(value.dtype).removeprefix('torch.')} {list(value.shape)}"
    if isinstance(value, Mapping):
        plain = all(isinstance(one, (str, int, float)) for one in value.values())
        entries = (f"{key!r}: {one!r}" if plain else repr(key) for key, one in value.items())
        return f"{{{_listed(entries, len(value))}}}"
    if isinstance(value, (tuple, list)):
        named = (repr(getattr(one, "name", one)) for one in value)
        return f"({_listed(named, len(value))})"
    return value.__qualname__ if hasattr(value, "__qualname__") else repr(value)


def _listed(texts: Iterable[str], count: int) -> str:
    entries = [text for text, _ in zip(texts, range(FEW), strict=False)]
    return ", ".join([*entries, f"and {count - FEW} more"] if count > FEW else entries)
