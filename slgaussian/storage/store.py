"""Content-addressed artifacts: arrays and tables on any file system, written whole or not at all.

The same content has the same digest (:mod:`slgaussian.storage.encoding`) and the same path.
"""

from __future__ import annotations

import errno
import json
import os
import re
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from slgaussian.errors import InputError, SpecError
from slgaussian.io import write_atomic
from slgaussian.storage.encoding import (
    REPAIR,
    Arrays,
    arrays_digest,
    decode_arrays,
    decode_table,
    packed,
    stated,
    table_digest,
)
from slgaussian.storage.local_copies import LocalCache
from slgaussian.storage.remote import explained, open_place, troubles
from slgaussian.storage.specs import load_spec, mismatch, spec_names

if TYPE_CHECKING:  # a field is read without Arrow and fsspec, which take long to import
    import pyarrow as pa

Item = TypeVar("Item")
Result = TypeVar("Result")

PART = 16 * 2**20
"""Bytes of a part of an upload; from two of them on it is done in parts, shown when all arrived."""

READINGS = 3
"""So often a file of a store elsewhere is read before it counts as damaged."""

AT_ONCE = 16
"""Requests that are under way at the same time where many small ones are made."""


class DamagedError(SpecError):
    """An artifact that is not there or not whole; ``uri`` is its place in the store."""

    def __init__(self, message: str, uri: str) -> None:
        super().__init__(message, uri)
        self.uri = uri

    def __str__(self) -> str:
        return str(self.args[0])


@dataclass(frozen=True)
class ArtifactRef:
    """A small, JSON-able stand-in for an artifact.

    Attributes
    ----------
    spec : str
        Name of the data spec it follows.
    uri : str
        Path relative to the root of the store, so that a store can move.
    digest : str
        SHA-256 of the content, hexadecimal; equal digests mean equal content.
    meta : dict
        A few plain values for people to read. Never part of the identity.
    """

    spec: str
    uri: str
    digest: str
    meta: dict[str, Any] = field(default_factory=dict, compare=False)

    @property
    def uris(self) -> list[str]:
        """Paths of the artifact and of the parts that it names."""
        return [self.uri, *self.meta.get("parts", ())]


@dataclass(frozen=True)
class File:
    """A file in a store: path relative to the root, bytes, and when it was written (Unix time)."""

    uri: str
    size: int
    written: float


class ArtifactStore:
    """Artifacts under one root, at ``<spec>/<aa>/<digest>.npz`` or ``.parquet``.

    Of a store on another machine, copies of what was read or written are kept on the local disk
    (:class:`~slgaussian.storage.local_copies.LocalCache`).

    Parameters
    ----------
    root : str or path
        A folder or any fsspec URL (``memory://x``, ``s3://bucket/prefix``). A folder is made when
        first written to, a bucket never.

    Attributes
    ----------
    root : str
        As passed, for people to read; it never holds credentials.
    fs, path
        The file system, and the root's path in it.
    local, near : bool
        Whether it is a folder, as a disk of this machine has; or that, or in this process.
    cache : LocalCache or None
        Copies of what is not near.

    Raises
    ------
    InputError
        If the URL holds credentials, fsspec does not know it, or the package that speaks its
        protocol is not installed.
    """

    def __init__(self, root: str | os.PathLike[str] = "./slg-data") -> None:
        from fsspec.implementations.local import LocalFileSystem
        from fsspec.implementations.memory import MemoryFileSystem

        self.fs, self.path = open_place(root, "store")
        self.local = isinstance(self.fs, LocalFileSystem)
        self.root = self.path if self.local else os.fspath(root).rstrip("/")
        self.near = self.local or isinstance(self.fs, MemoryFileSystem)
        self.cache = None if self.near else LocalCache.from_environment()

    def put(
        self, spec: str, content: Mapping[str, np.ndarray] | pa.Table, meta: dict | None = None
    ) -> ArtifactRef:
        """Write an artifact and return its ref; the same content twice is one file.

        It is written even if it is there: one that is damaged is then whole again, and one that
        nothing refers to yet is young again for :func:`slgaussian.storage.housekeeping.collect`.
        Where other work made the same content before, of the two statements of what made it the
        one that is first in order stays, so that the bytes do not depend on who came first.
        ``meta`` of the ref also has the ``bytes`` of the file.

        Raises
        ------
        SpecError
            If the content is not what ``data_specs/<spec>.toml`` says.
        InputError
            If the store cannot be written to.
        """
        digest, data = packed(spec, content, f"new {spec} artifact")
        ref, is_new = ArtifactRef(spec, address(spec, digest), digest), True
        while True:
            there = None
            with suppress(SpecError):  # nothing there, or nothing whole
                there, _ = self.fetch(
                    ref.uri, "an artifact", lambda read: self.near or self.understood(ref, read)
                )
                if _precedence(there) < _precedence(data):
                    self.understood(ref, there)
                    data = there
            try:
                self.write(ref.uri, data, new=is_new and there is None)
            except FileExistsError:  # others made the same in between, or it cannot be read
                is_new = False
                continue
            if self.cache is not None:
                self.cache.put(ref.uri, data)
            return replace(ref, meta={**(meta or {}), "bytes": len(data)})

    def get(self, ref: ArtifactRef) -> Any:
        """Read an artifact, arrays by name or a table, checked against its spec and its digest.

        Raises
        ------
        DamagedError
            If the file is missing, cut short, altered or not what the spec says: one sentence
            with the file, the field, what was found and what was expected.
        InputError
            If a store on another machine does not answer.
        """
        self._check_address(ref)
        if self.cache is not None and (data := self.cache.get(ref.uri)) is not None:
            with suppress(SpecError):
                return self.understood(ref, data)
            self.cache.drop(ref.uri)
        data, content = self._fetch_artifact(ref)
        if self.cache is not None:
            self.cache.put(ref.uri, data)
        return content

    def understood(self, ref: ArtifactRef, data: bytes) -> Arrays | pa.Table:
        """Return the content of an artifact's bytes; DamagedError if ``ref`` says otherwise."""
        rules, file = load_spec(ref.spec), f"{self.root}/{ref.uri}"
        content: Arrays | pa.Table
        try:
            if rules.columns:
                content = decode_table(data, rules, file)
                digest = table_digest(content)
            else:
                content = decode_arrays(data, rules, file)
                digest = arrays_digest(content)
        except SpecError as error:
            raise DamagedError(str(error), ref.uri) from error
        if digest != ref.digest:
            actual, expected = f"content {digest[:12]}", f"{ref.digest[:12]}; {REPAIR}"
            raise self._damaged(ref.uri, actual, expected, "digest")
        return content

    def read(self, uri: str, expected: str = "a file") -> bytes:
        """Read a file; DamagedError if it is not there, ``expected`` names it."""
        passed = OSError if self.local else FileNotFoundError
        try:
            return self._ask("read", lambda: self.fs.cat_file(f"{self.path}/{uri}"), passed)
        except FileNotFoundError as error:
            raise self._damaged(uri, "nothing", expected) from error
        except OSError as error:
            raise self._damaged(uri, explained(error), "a readable file") from error

    def fetch(
        self, uri: str, expected: str, understood: Callable[[bytes], Result]
    ) -> tuple[bytes, Result]:
        """Return the bytes of a file, and what ``understood`` makes of them.

        What came over a network and is not understood may have been cut short on the way, and is
        read again before that is believed. SpecError then, as ``understood`` raises it, and as
        :meth:`read`.
        """
        for left in reversed(range(1 if self.near else READINGS)):
            data = self.read(uri, expected)
            try:
                return data, understood(data)
            except SpecError:
                if not left:
                    raise
        raise AssertionError  # the last reading has raised

    def lay_out(self, ref: ArtifactRef, path: str | os.PathLike[str]) -> None:
        """Make a new local file that is an artifact's: a hard link if it can be one, else a copy.

        A link takes no room. It outlives the artifact: what is removed from a store or made anew
        there leaves it as it was.

        Raises
        ------
        DamagedError
            If the artifact is missing or damaged.
        InputError
            If a store on another machine does not answer.
        OSError
            If the file cannot be written.
        """
        self._check_address(ref)
        data, _ = self._fetch_artifact(ref)
        if self.local:
            # It fails on another disk, one that has no links, or where another user owns the file.
            with suppress(OSError):
                os.link(f"{self.path}/{ref.uri}", path)
                return
        Path(path).write_bytes(data)

    def is_laid_out(self, ref: ArtifactRef, path: str | os.PathLike[str]) -> bool:
        """Tell whether a local file holds what :meth:`lay_out` would make it hold."""
        try:
            self.understood(ref, Path(path).read_bytes())
        except (OSError, DamagedError):
            return False
        return True

    def check(self, ref: ArtifactRef) -> None:
        """Raise :class:`DamagedError` if the artifact, or a part that it names, is not whole.

        Those of a local store are read and compared with their digests. Of one elsewhere it is only
        asked whether they are there: to fetch everything for a run that finds all of it done would
        take hours, and damage is found when they are read.
        """
        self._check_address(ref)
        if not self.near:
            self.at_once(self.check_there, ref.uris)
            return
        for uri in ref.uris:
            part = ref_of(uri)
            if part is None:
                raise self._damaged(uri, "another path", "that of an artifact")
            self.get(part)

    def stamp(self, uri: str) -> str | None:
        """Return bytes and time (ns) of a file of a local store; None without one, or elsewhere."""
        with suppress(OSError):
            if self.local:
                state = os.stat(f"{self.path}/{uri}")
                return f"{state.st_size} {state.st_mtime_ns}"
        return None

    def check_there(self, uri: str) -> None:
        """Raise :class:`DamagedError` if there is no file at a path relative to the root."""
        if not self._ask("read", lambda: self.fs.exists(f"{self.path}/{uri}")):
            raise self._damaged(uri, "nothing", "an artifact")

    def check_writable(self) -> None:
        """Raise :class:`InputError` now rather than after the work if nothing can be written."""
        self.clock()

    def clock(self) -> float:
        """Return the Unix time that files are stamped with; InputError if none can be written."""
        probe = f".probe-{uuid.uuid4().hex}"
        self.write(probe, b"")
        try:
            return _written(self._ask("read", lambda: self.fs.info(f"{self.path}/{probe}")))
        finally:
            self.remove([probe])

    def write(self, uri: str, data: bytes, new: bool = False) -> None:
        """Write a file that is no artifact, whole or not at all; InputError if that fails.

        FileExistsError if it is to be ``new`` and is there, where the file system can tell.
        """
        path = f"{self.path}/{uri}"

        def write_file() -> None:
            if self.local:
                os.makedirs(os.path.dirname(path), exist_ok=True)
                write_atomic(path, data, sync=True, new=new)
            else:
                # One put, or parts that are shown when the last has arrived: whole or not at all.
                self.fs.pipe_file(path, data, **({} if self.near else {"chunksize": PART}))

        self._ask("write", write_file, FileExistsError if new else ())

    def remove(self, uris: Iterable[str]) -> None:
        """Delete files, whether they are there or not; InputError if that fails."""

        def remove_file(uri: str) -> None:
            if self.cache is not None:
                self.cache.drop(uri)
            with suppress(FileNotFoundError):
                path = f"{self.path}/{uri}"
                self._ask("delete", lambda: self.fs.rm_file(path), FileNotFoundError)

        self.at_once(remove_file, list(uris))

    def walk(self, folders: Sequence[str] = ("",)) -> Iterator[list[File]]:
        """Yield the files in folders and all below, a folder at a time; nothing where none is.

        InputError if the store cannot be read.
        """
        for start in range(0, len(folders), AT_ONCE):
            for files, below in self.at_once(self._list, folders[start : start + AT_ONCE]):
                if files:
                    yield files
                yield from self.walk(below)

    def at_once(
        self, function: Callable[[Item], Result], items: Sequence[Item], workers: int = AT_ONCE
    ) -> list[Result]:
        """Call a function for each item, those of a store elsewhere side by side: it waits."""
        if self.near or len(items) < 2:
            return [function(item) for item in items]
        with ThreadPoolExecutor(workers) as pool:
            return list(pool.map(function, items))

    def _ask(
        self,
        verb: str,
        request: Callable[[], Result],
        passed: type[Exception] | tuple[type[Exception], ...] = (),
    ) -> Result:
        """Make a request; InputError that one cannot ``verb`` there, of errors not ``passed``."""
        try:
            return request()
        except troubles() as error:
            if isinstance(error, passed):
                raise
            do = "; choose a writable folder with --store" if self.local and verb == "write" else ""
            if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
                do = "; make room there (`slgaussian store gc`), and run again"
            reason = explained(error, self.path)
            message = f"store {self.root}: cannot {verb} there ({reason}){do}"
            raise InputError(message) from error

    def _fetch_artifact(self, ref: ArtifactRef) -> tuple[bytes, Any]:
        expected = f"a {ref.spec} artifact"
        return self.fetch(ref.uri, expected, lambda data: self.understood(ref, data))

    def _list(self, uri: str) -> tuple[list[File], list[str]]:
        """Return the files in a folder and the folders in it, each sorted."""
        files, folders = [], []
        try:
            folder = f"{self.path}/{uri}".rstrip("/")
            none = FileNotFoundError, NotADirectoryError
            entries = self._ask("read", lambda: self.fs.ls(folder, detail=True), none)
        except (FileNotFoundError, NotADirectoryError):
            return [], []
        for entry in entries:
            inside = entry["name"].rstrip("/").removeprefix(f"{self.path}/")
            if inside == uri:
                continue  # an object store may have a file of the folder's name
            if entry["type"] == "directory":
                folders.append(inside)
            else:
                files.append(File(inside, entry["size"], _written(entry)))
        return sorted(files, key=lambda file: file.uri), sorted(folders)

    def _check_address(self, ref: ArtifactRef) -> None:
        expected = address(ref.spec, ref.digest)
        if not is_digest(ref.digest):
            raise self._damaged(ref.uri, f"the digest {ref.digest!r:.80}", "64 hexadecimal digits")
        if ref.uri != expected:
            raise self._damaged(ref.uri, "a ref to it", f"one to {expected}")

    def _damaged(self, uri: str, actual: str, expected: str, field: str = "file") -> DamagedError:
        return DamagedError(str(mismatch(f"{self.root}/{uri}", field, actual, expected)), uri)


def address(spec: str, digest: str) -> str:
    """Return the path of an artifact relative to the root of its store."""
    return f"{spec}/{digest[:2]}/{digest}{load_spec(spec).suffix}"


def ref_of(uri: str) -> ArtifactRef | None:
    """Return the ref of the artifact at a path of a store; None if it is another file."""
    spec, digest = uri.partition("/")[0], uri.rpartition("/")[2].partition(".")[0]
    is_artifact = spec in spec_names() and is_digest(digest) and uri == address(spec, digest)
    return ArtifactRef(spec, uri, digest) if is_artifact else None


def is_digest(text: str) -> bool:
    """Tell whether it is a SHA-256, hexadecimal, and so no way out of a folder either."""
    return re.fullmatch(r"[0-9a-f]{64}", text) is not None


def _written(info: Mapping[str, Any]) -> float:
    """Return when a file was written, as its file system says it."""
    stamp = next(info[name] for name in ("mtime", "LastModified", "created") if name in info)
    return stamp.timestamp() if isinstance(stamp, datetime) else float(stamp)


def _precedence(data: bytes) -> tuple[bool, str]:
    """Return what orders two files of the same content: one that names its maker is first."""
    try:
        maker = stated(data).get("made", {})
        return "stage" not in maker, json.dumps(maker, sort_keys=True)
    except Exception:  # a damaged file raises almost anything
        return True, "~"
