"""Content-addressed store of arrays and tables on any file system, with atomic writes.

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
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from slgaussian.errors import InputError, SpecError
from slgaussian.io import write_atomic
from slgaussian.storage.encoding import (
    REPAIR,
    Arrays,
    decode_artifact,
    encode_artifact,
    read_metadata,
)
from slgaussian.storage.local_copies import LocalCache
from slgaussian.storage.remote import explain_error, file_system_errors, open_file_system
from slgaussian.storage.specs import load_spec, mismatch, spec_names

if TYPE_CHECKING:  # reading a field does not need Arrow and fsspec, whose import is slow
    import pyarrow as pa

Item = TypeVar("Item")
Result = TypeVar("Result")

UPLOAD_PART_BYTES = 16 * 2**20
"""Bytes of a part of a multipart upload, which becomes visible when all parts have arrived."""

READ_ATTEMPTS = 3
"""Number of attempts to read a file of a remote store before it counts as damaged."""

CONCURRENT_REQUESTS = 16
"""Number of concurrent small requests."""

CONCURRENT_READS = 4
"""Number of artifacts of a remote store read concurrently; each may take 100 MB of memory."""


class DamagedError(SpecError):
    """An artifact is missing or damaged; ``uri`` is its path in the store."""

    def __init__(self, message: str, uri: str) -> None:
        super().__init__(message, uri)
        self.uri = uri

    def __str__(self) -> str:
        return str(self.args[0])


class StoreError(InputError):
    """The store is full, gone, denied or does not answer, so no work on it can succeed."""


@dataclass(frozen=True)
class ArtifactRef:
    """A small, JSON-serialisable reference to an artifact.

    Attributes:
        spec: Name of its data spec.
        uri: Path relative to the root of the store, so that a store can be moved.
        digest: SHA-256 of the content, hexadecimal; equal digests mean equal content.
        meta: Plain values for information, not part of the identity.
    """

    spec: str
    uri: str
    digest: str
    meta: dict[str, Any] = field(default_factory=dict, compare=False)

    @property
    def uris(self) -> list[str]:
        """Paths of the artifact and of its parts."""
        return [self.uri, *self.meta.get("parts", ())]


@dataclass(frozen=True)
class File:
    """A file in a store: path relative to the root, bytes, and when it was written (Unix time)."""

    uri: str
    size: int
    written: float


class ArtifactStore:
    """Artifacts under one root, at ``<spec>/<aa>/<digest>.npz`` or ``.parquet``.

    Files of a remote store that were read or written are cached on the local disk
    (:class:`~slgaussian.storage.local_copies.LocalCache`).

    Args:
        root: str or path. A folder or any fsspec URL (``memory://x``, ``s3://bucket/prefix``). A
            folder is created on the first write, a bucket never.

    Attributes:
        root: As passed, for messages; without credentials.
        fs, path: The file system, and the root's path in it.
        local, near, s3: bool. Whether it is a local folder; a local folder or in the memory of this
            process; a bucket of S3, which is paid by the request.
        cache: LocalCache or None. Local copies of the files of a store that is not near.

    Raises:
        InputError: If the URL contains credentials, fsspec does not know its protocol, or the
            package for that protocol is not installed.
    """

    def __init__(self, root: str | os.PathLike[str] = "./slg-data") -> None:
        from fsspec.implementations.local import LocalFileSystem
        from fsspec.implementations.memory import MemoryFileSystem

        self.fs, self.path = open_file_system(root, "store")
        self.local = isinstance(self.fs, LocalFileSystem)
        self.root = self.path if self.local else os.fspath(root).rstrip("/")
        self.near = self.local or isinstance(self.fs, MemoryFileSystem)
        self.s3 = "s3" in self.fs.protocol
        self.cache = None if self.near else LocalCache.from_environment()

    def put(
        self, spec: str, content: Mapping[str, np.ndarray] | pa.Table, meta: dict | None = None
    ) -> ArtifactRef:
        """Write an artifact and return its ref; the same content twice is one file.

        An existing file is written again, which repairs damage and renews its time, so that
        :func:`slgaussian.storage.housekeeping.collect` does not remove it before it has a record.
        If files of the same content have different provenance, the provenance that sorts first is
        kept, so the bytes do not depend on the order of runs.

        Raises:
            SpecError: If the content breaks ``data_specs/<spec>.toml``.
            StoreError: If the store cannot be written.
        """
        digest, data = encode_artifact(spec, content, f"new {spec} artifact")
        ref = ArtifactRef(spec, address(spec, digest), digest, dict(meta or {}))
        if not (self.s3 and self._create(ref.uri, data)):
            with suppress(SpecError):  # missing or damaged
                data = min(data, self._fetch_artifact(ref)[0], key=_precedence)
            self.write(ref.uri, data)
        if self.cache is not None:
            self.cache.put(ref.uri, data)
        return ref

    def get(self, ref: ArtifactRef) -> Any:
        """Read an artifact, arrays by name or a table, and check its spec and digest.

        Raises:
            DamagedError: If the file is missing, truncated, altered or breaks its spec. The message
                has the file, the field, the actual and the expected value.
            StoreError: If a remote store does not answer.
        """
        self._check_address(ref)
        if self.cache is not None and (data := self.cache.get(ref.uri)) is not None:
            with suppress(SpecError):
                return self.decode(ref, data)
            self.cache.drop(ref.uri)
        data, content = self._fetch_artifact(ref)
        if self.cache is not None:
            self.cache.put(ref.uri, data)
        return content

    def decode(self, ref: ArtifactRef, data: bytes) -> Arrays | pa.Table:
        """Decode the bytes of an artifact; DamagedError if its spec or digest do not match."""
        try:
            digest, content = decode_artifact(data, load_spec(ref.spec), f"{self.root}/{ref.uri}")
        except SpecError as error:
            raise DamagedError(str(error), ref.uri) from error
        if digest != ref.digest:
            actual, expected = f"content {digest[:12]}", f"{ref.digest[:12]}; {REPAIR}"
            raise self._damage(ref.uri, actual, expected, "digest")
        return content

    def read(self, uri: str, expected: str = "a file") -> bytes:
        """Read a file; DamagedError if it is missing, ``expected`` describes it."""
        passed = OSError if self.local else FileNotFoundError
        # In one request: s3fs asks for the size first, to read parts concurrently.
        whole = {"max_concurrency": 1} if self.s3 else {}
        try:
            return self._ask(
                "read", lambda: self.fs.cat_file(f"{self.path}/{uri}", **whole), passed
            )
        except FileNotFoundError as error:
            raise self._damage(uri, "nothing", expected) from error
        except OSError as error:
            raise self._damage(uri, explain_error(error), "a readable file") from error

    def fetch(
        self, uri: str, expected: str, decode: Callable[[bytes], Result]
    ) -> tuple[bytes, Result]:
        """Return the bytes of a file, and the result of ``decode`` for these bytes.

        If ``decode`` raises SpecError, a file of a remote store is read again, because the
        transfer may have been truncated. SpecError of the last attempt, or of :meth:`read`.
        """
        for _ in range(0 if self.near else READ_ATTEMPTS - 1):
            data = self.read(uri, expected)
            with suppress(SpecError):
                return data, decode(data)
        data = self.read(uri, expected)
        return data, decode(data)

    def link_or_copy(self, ref: ArtifactRef, path: str | os.PathLike[str]) -> None:
        """Create a local file of an artifact: a hard link if possible, else a copy.

        A link takes no disk space. It stays unchanged when the artifact is removed from the store
        or written again.

        Raises:
            DamagedError: If the artifact is missing or damaged.
            StoreError: If a remote store does not answer.
            OSError: If the file cannot be written.
        """
        self._check_address(ref)
        data, _ = self._fetch_artifact(ref)
        if self.local:
            # Fails across disks, without support of links, or if another user owns the file.
            with suppress(OSError):
                os.link(f"{self.path}/{ref.uri}", path)
                return
        Path(path).write_bytes(data)

    def has_content(self, ref: ArtifactRef, path: str | os.PathLike[str]) -> bool:
        """Return whether a local file already has the content that :meth:`link_or_copy` writes.

        A hard link to the artifact is not read: records notice when that was written to.
        """
        with suppress(OSError):
            if self.local and os.path.samefile(f"{self.path}/{ref.uri}", path):
                return True
        with suppress(OSError, DamagedError):
            self.decode(ref, Path(path).read_bytes())
            return True
        return False

    def check(self, ref: ArtifactRef) -> None:
        """Raise :class:`DamagedError` if the artifact or one of its parts is missing or damaged.

        Files of a local store are read and their digests compared. For a remote store only their
        existence is checked: downloading all files of a cached run would take hours, and damage is
        detected when they are read.
        """
        self._check_address(ref)
        if not self.near:
            self.map(self.check_exists, ref.uris)
            return
        for uri in ref.uris:
            part = parse_uri(uri)
            if part is None:
                raise self._damage(uri, "another path", "that of an artifact")
            self.get(part)

    def stamp(self, uri: str) -> str | None:
        """Return size and time (ns) of a local store's file; None if missing or remote."""
        with suppress(OSError):
            if self.local:
                state = os.stat(f"{self.path}/{uri}")
                return f"{state.st_size} {state.st_mtime_ns}"
        return None

    def check_exists(self, uri: str) -> None:
        """Raise :class:`DamagedError` if there is no file at a path relative to the root."""
        if not self._ask("read", lambda: self.fs.exists(f"{self.path}/{uri}")):
            raise self._damage(uri, "nothing", "an artifact")

    def check_writable(self) -> None:
        """Raise :class:`StoreError` if the store cannot be written; call it before the work."""
        self.clock()

    def clock(self) -> float:
        """Return the store's Unix time, from a new file; StoreError if it cannot be written."""
        probe = f".probe-{uuid.uuid4().hex}"
        self.write(probe, b"")
        try:
            return _written(self._ask("read", lambda: self.fs.info(f"{self.path}/{probe}")))
        finally:
            self.remove([probe])

    def write(self, uri: str, data: bytes) -> None:
        """Write a file atomically; StoreError if that fails."""
        self._ask("write", partial(self._write, uri, data))

    def _create(self, uri: str, data: bytes) -> bool:
        """Write a file of a bucket in one request if there is none; return whether it was written.

        A server that ignores the condition replaces the file by one of the same content.
        """
        with suppress(OSError):  # it exists, or the server cannot do this; other errors come again
            self._ask("write", partial(self._write, uri, data, mode="create"), OSError)
            return True
        return False

    def _write(self, uri: str, data: bytes, **options: str) -> None:
        path = f"{self.path}/{uri}"
        if self.local:
            os.makedirs(os.path.dirname(path), exist_ok=True)
            write_atomic(path, data, sync=True)
        else:
            # A single put or a multipart upload, both of which are atomic.
            size = {} if self.near else {"chunksize": UPLOAD_PART_BYTES}
            self.fs.pipe_file(path, data, **size, **options)

    def remove(self, uris: Iterable[str]) -> None:
        """Delete files; missing files are ignored. StoreError if that fails."""

        def remove_file(uri: str) -> None:
            if self.cache is not None:
                self.cache.drop(uri)
            with suppress(FileNotFoundError):
                path = f"{self.path}/{uri}"
                self._ask("delete", lambda: self.fs.rm_file(path), FileNotFoundError)

        self.map(remove_file, list(uris))

    def walk(self, folders: Sequence[str] = ("",)) -> Iterator[list[File]]:
        """Yield the files in folders and their subfolders, one list for each folder.

        Missing folders are ignored. StoreError if the store cannot be read.
        """
        for start in range(0, len(folders), CONCURRENT_REQUESTS):
            for files, below in self.map(self._list, folders[start : start + CONCURRENT_REQUESTS]):
                if files:
                    yield files
                yield from self.walk(below)

    def map(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        workers: int = CONCURRENT_REQUESTS,
    ) -> list[Result]:
        """Call a function for each item, concurrently for a remote store to hide latency."""
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
        """Make a request; StoreError with ``verb`` for its errors, except the types ``passed``."""
        try:
            return request()
        except file_system_errors() as error:
            if isinstance(error, passed):
                raise
            writes = self.local and verb == "write"
            hint = "; choose a writable folder with --store" if writes else ""
            if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
                hint = "; make room there (`slgaussian store gc`), and run again"
            message = f"store {self.root}: cannot {verb} there ({explain_error(error)}){hint}"
            raise StoreError(message) from error

    def _fetch_artifact(self, ref: ArtifactRef) -> tuple[bytes, Any]:
        expected = f"a {ref.spec} artifact"
        return self.fetch(ref.uri, expected, lambda data: self.decode(ref, data))

    def _list(self, uri: str) -> tuple[list[File], list[str]]:
        """Return the files and the folders in a folder, each sorted."""
        files, folders = [], []
        try:
            folder = f"{self.path}/{uri}".rstrip("/")
            missing = FileNotFoundError, NotADirectoryError
            entries = self._ask("read", lambda: self.fs.ls(folder, detail=True), missing)
        except (FileNotFoundError, NotADirectoryError):
            return [], []
        for entry in entries:
            inside = entry["name"].rstrip("/").removeprefix(f"{self.path}/")
            if inside == uri:
                continue  # an object store may have a file with the name of the folder
            if entry["type"] == "directory":
                folders.append(inside)
            else:
                files.append(File(inside, entry["size"], _written(entry)))
        return sorted(files, key=lambda file: file.uri), sorted(folders)

    def _check_address(self, ref: ArtifactRef) -> None:
        if not is_digest(ref.digest) or ref.uri != address(ref.spec, ref.digest):
            raise self._damage(ref.uri, f"digest {ref.digest!r:.80}", "that of the path")

    def _damage(self, uri: str, actual: str, expected: str, field: str = "file") -> DamagedError:
        return DamagedError(str(mismatch(f"{self.root}/{uri}", field, actual, expected)), uri)


def address(spec: str, digest: str) -> str:
    """Return the path of an artifact relative to the root of its store."""
    return f"{spec}/{digest[:2]}/{digest}{load_spec(spec).suffix}"


def parse_uri(uri: str) -> ArtifactRef | None:
    """Return the ref of the artifact at a path of a store; None for other files."""
    spec, digest = uri.partition("/")[0], uri.rpartition("/")[2].partition(".")[0]
    is_artifact = spec in spec_names() and is_digest(digest) and uri == address(spec, digest)
    return ArtifactRef(spec, uri, digest) if is_artifact else None


def is_digest(text: str) -> bool:
    """Return whether a text is a hexadecimal SHA-256, and thus safe as a file name."""
    return re.fullmatch(r"[0-9a-f]{64}", text) is not None


def _written(info: Mapping[str, Any]) -> float:
    """Return the time at which a file was written, from its file system."""
    stamp = next(info[name] for name in ("mtime", "LastModified", "created") if name in info)
    return stamp.timestamp() if isinstance(stamp, datetime) else float(stamp)


def _precedence(data: bytes) -> tuple[bool, str]:
    """Return the sort key of files of the same content: those with a stage come first."""
    try:
        maker = read_metadata(data).get("made", {})
        return "stage" not in maker, json.dumps(maker, sort_keys=True)
    except Exception:  # a damaged file raises almost anything
        return True, "~"
