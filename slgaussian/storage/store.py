"""Content-addressed artifacts: arrays and tables on any file system, written whole or not at all.

The same content has the same digest and the same path. The digest is over the content and not over
the file, whose bytes also depend on the versions of NumPy, zlib and Arrow, and say what made it
(:mod:`slgaussian.storage.provenance`): the digest outlives all of these.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import re
import uuid
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from slgaussian.errors import InputError, SpecError
from slgaussian.formats import strict_json
from slgaussian.io import write_atomic
from slgaussian.storage.local_copies import LocalCache
from slgaussian.storage.provenance import speaking, statement
from slgaussian.storage.remote import explained, open_place, patiently, troubles
from slgaussian.storage.specs import ABOUT, Spec, load_spec, mismatch, spec_names
from slgaussian.storage.tables import MOST_UNPACKED, read_table

if TYPE_CHECKING:  # a field is read without Arrow and fsspec, which take long to import
    import pyarrow as pa

Arrays = dict[str, np.ndarray]
Item = TypeVar("Item")
Result = TypeVar("Result")

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest that a zip can hold; now would change the bytes
REPAIR = "delete the file and run again to have it made anew"
"""What to do about a damaged artifact."""

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
        As given, for people to read; it never holds credentials.
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
        ref = ArtifactRef(spec, address(spec, digest), digest)
        data = self._settle(ref, data)
        if self.cache is not None:
            self.cache.put(ref.uri, data)
        return replace(ref, meta={**(meta or {}), "bytes": len(data)})

    def _settle(self, ref: ArtifactRef, data: bytes) -> bytes:
        """Write an artifact: these bytes, or again those that are there; returns which."""
        new = True
        while True:
            there = None
            try:
                there, _ = self.fetch(ref.uri, "an artifact", lambda own: self._whole(ref, own))
                if _precedence(there) < _precedence(data):
                    self.understood(ref, there)
                    data = there
            except SpecError:
                pass  # nothing there, or nothing whole
            try:
                self.write(ref.uri, data, new=new and there is None)
            except FileExistsError:  # others made the same in between, or it cannot be read
                new = False
                continue
            return data

    def _whole(self, ref: ArtifactRef, data: bytes) -> None:
        """SpecError if what came over a network is not all of an artifact."""
        if not self.near:
            self.understood(ref, data)

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
        what = f"a {ref.spec} artifact"
        data, content = self.fetch(ref.uri, what, lambda data: self.understood(ref, data))
        if self.cache is not None:
            self.cache.put(ref.uri, data)
        return content

    def understood(self, ref: ArtifactRef, data: bytes) -> Arrays | pa.Table:
        """What the bytes of an artifact hold; DamagedError if they are not what ``ref`` says."""
        rules = load_spec(ref.spec)
        file = f"{self.root}/{ref.uri}"
        try:
            content: Arrays | pa.Table
            if rules.columns:
                content = decode_table(data, rules, file)
                digest = table_digest(content)
            else:
                content = decode_arrays(data, rules, file)
                digest = arrays_digest(content)
        except SpecError as error:
            raise DamagedError(str(error), ref.uri) from error
        if digest != ref.digest:
            found, expected = f"content {digest[:12]}", f"{ref.digest[:12]}; {REPAIR}"
            raise self._damaged(ref.uri, found, expected, "digest")
        return content

    def read(self, uri: str, what: str = "a file") -> bytes:
        """The bytes of a file; DamagedError if it is not there, ``what`` says what was expected."""
        try:
            return self._ask(lambda: self.fs.cat_file(f"{self.path}/{uri}"))
        except FileNotFoundError as error:
            raise self._damaged(uri, "nothing", what) from error
        except troubles() as error:
            if not self.local:
                raise self._failed("read", error) from error
            raise self._damaged(uri, explained(error), "a readable file") from error

    def fetch(
        self, uri: str, what: str, understood: Callable[[bytes], Result]
    ) -> tuple[bytes, Result]:
        """The bytes of a file, and what ``understood`` makes of them.

        What came over a network and is not understood may have been cut short on the way, and is
        read again before that is believed. SpecError then, as ``understood`` raises it, and as
        :meth:`read`.
        """
        for left in reversed(range(1 if self.near else READINGS)):
            data = self.read(uri, what)
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
        what = f"a {ref.spec} artifact"
        data, _ = self.fetch(ref.uri, what, lambda data: self.understood(ref, data))
        if self.local:
            # It fails on another disk, one that has no links, or where another user owns the file.
            with suppress(OSError):
                os.link(f"{self.path}/{ref.uri}", path)
                return
        with open(path, "wb") as file:
            file.write(data)

    def is_laid_out(self, ref: ArtifactRef, path: str | os.PathLike[str]) -> bool:
        """Whether a local file holds what :meth:`lay_out` would make it hold."""
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
        uris = [ref.uri, *ref.meta.get("parts", ())]
        if not self.near:
            self.at_once(self.check_there, uris)
            return
        for uri in uris:
            one = ref_of(uri)
            if one is None:
                raise self._damaged(uri, "another path", "that of an artifact")
            self.get(one)

    def stamp(self, uri: str) -> str | None:
        """Bytes and time (ns) of a file of a local store; None if it has none, or elsewhere."""
        if not self.local:
            return None
        try:
            found = os.stat(f"{self.path}/{uri}")
        except OSError:
            return None
        return f"{found.st_size} {found.st_mtime_ns}"

    def check_there(self, uri: str) -> None:
        """Raise :class:`DamagedError` if there is no file at a path relative to the root."""
        try:
            there = self._ask(lambda: self.fs.exists(f"{self.path}/{uri}"))
        except troubles() as error:
            raise self._failed("read", error) from error
        if not there:
            raise self._damaged(uri, "nothing", "an artifact")

    def check_writable(self) -> None:
        """Raise :class:`InputError` now rather than after the work if nothing can be written."""
        self.clock()

    def clock(self) -> float:
        """Unix time of the clock that stamps the files; InputError if nothing can be written."""
        probe = f".probe-{uuid.uuid4().hex}"
        self.write(probe, b"")
        try:
            return _written(self._ask(lambda: self.fs.info(f"{self.path}/{probe}")))
        except troubles() as error:
            raise self._failed("read", error) from error
        finally:
            self.remove([probe])

    def write(self, uri: str, data: bytes, new: bool = False) -> None:
        """Write a file that is no artifact, whole or not at all; InputError if that fails.

        FileExistsError if it is to be ``new`` and is there, where the file system can tell.
        """
        path = f"{self.path}/{uri}"
        try:
            if self.local:
                os.makedirs(os.path.dirname(path), exist_ok=True)
                write_atomic(path, data, sync=True, new=new)
            elif self.near:
                self.fs.pipe_file(path, data)
            else:
                # One put, or parts that are shown when the last has arrived: whole or not at all.
                self._ask(lambda: self.fs.pipe_file(path, data, chunksize=PART))
        except FileExistsError as error:
            if new:
                raise
            raise self._failed("write", error) from error
        except troubles() as error:
            raise self._failed("write", error) from error

    def remove(self, uris: Iterable[str]) -> None:
        """Delete files, whether they are there or not; InputError if that fails."""
        try:
            self.at_once(self._remove, list(uris))
        except troubles() as error:
            raise self._failed("delete", error) from error

    def walk(self, folders: Sequence[str] = ("",)) -> Iterator[list[File]]:
        """The files in folders and all below, a folder at a time; nothing where there is none.

        InputError if the store cannot be read.
        """
        for start in range(0, len(folders), AT_ONCE):
            for files, below in self.at_once(self._listed, folders[start : start + AT_ONCE]):
                if files:
                    yield files
                yield from self.walk(below)

    def at_once(
        self, function: Callable[[Item], Result], items: Sequence[Item], most: int = AT_ONCE
    ) -> list[Result]:
        """``function`` of each item, those of a store elsewhere side by side: it waits mostly."""
        if self.near or len(items) < 2:
            return [function(item) for item in items]
        with ThreadPoolExecutor(most) as pool:
            return list(pool.map(function, items))

    def _ask(self, request: Callable[[], Result]) -> Result:
        """Do a request, one of a store elsewhere patiently."""
        return request() if self.near else patiently(request)

    def _remove(self, uri: str) -> None:
        if self.cache is not None:
            self.cache.drop(uri)
        with suppress(FileNotFoundError):
            self._ask(lambda: self.fs.rm_file(f"{self.path}/{uri}"))

    def _listed(self, uri: str) -> tuple[list[File], list[str]]:
        """The files in a folder and the folders in it, each sorted."""
        files, folders = [], []
        try:
            folder = f"{self.path}/{uri}".rstrip("/")
            entries = self._ask(lambda: self.fs.ls(folder, detail=True))
        except (FileNotFoundError, NotADirectoryError):
            return [], []
        except troubles() as error:
            raise self._failed("read", error) from error
        for entry in entries:
            own = self._relative(entry)
            if own == uri:
                continue  # an object store may have a file of the folder's name
            if entry["type"] == "directory":
                folders.append(own)
            else:
                files.append(File(own, entry["size"], _written(entry)))
        return sorted(files, key=lambda file: file.uri), sorted(folders)

    def _relative(self, entry: Mapping[str, Any]) -> str:
        return entry["name"].rstrip("/").removeprefix(f"{self.path}/")

    def _check_address(self, ref: ArtifactRef) -> None:
        expected = address(ref.spec, ref.digest)
        if not is_digest(ref.digest):
            raise self._damaged(ref.uri, f"the digest {ref.digest!r:.80}", "64 hexadecimal digits")
        if ref.uri != expected:
            raise self._damaged(ref.uri, "a ref to it", f"one to {expected}")

    def _damaged(self, uri: str, found: str, expected: str, field: str = "file") -> DamagedError:
        return DamagedError(str(mismatch(f"{self.root}/{uri}", field, found, expected)), uri)

    def _failed(self, verb: str, error: Exception) -> InputError:
        why = explained(error, self.path)
        do = "; choose a writable folder with --store" if self.local and verb == "write" else ""
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            do = "; make room there (`slgaussian store gc`), and run again"
        return InputError(f"store {self.root}: cannot {verb} there ({why}){do}")


def address(spec: str, digest: str) -> str:
    """Path of an artifact relative to the root of its store."""
    return f"{spec}/{digest[:2]}/{digest}{load_spec(spec).suffix}"


def ref_of(uri: str) -> ArtifactRef | None:
    """The ref of the artifact that a file of a store is by its path; None if it is another file."""
    spec, digest = uri.partition("/")[0], uri.rpartition("/")[2].partition(".")[0]
    known = spec in spec_names() and is_digest(digest) and uri == address(spec, digest)
    return ArtifactRef(spec, uri, digest) if known else None


def is_digest(text: str) -> bool:
    """Whether it is a SHA-256, hexadecimal, and so no way out of a folder either."""
    return re.fullmatch(r"[0-9a-f]{64}", text) is not None


def _written(info: Mapping[str, Any]) -> float:
    """When a file was written, as its file system says it."""
    stamp = next(info[name] for name in ("mtime", "LastModified", "created") if name in info)
    return stamp.timestamp() if isinstance(stamp, datetime) else float(stamp)


def arrays_digest(arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 over (name, dtype, shape, C-order bytes) of the arrays in order of their names."""
    sha = hashlib.sha256()
    for name in sorted(arrays):
        array = np.asarray(arrays[name], order="C")
        sha.update(f"{name}\0{array.dtype.str}\0{array.shape}\0".encode())
        sha.update(array.reshape(-1).view(np.uint8).data)
    return sha.hexdigest()


def table_digest(table: pa.Table) -> str:
    """SHA-256 over the column names, types and values of a table, whatever its chunks."""
    # Parquet calls what a list holds "element", Arrow "item".
    types = [str(f.type).replace("list<element:", "list<item:") for f in table.schema]
    named = zip(table.schema.names, types, strict=True)
    columns = [[name, kind, table.column(name).to_pylist()] for name, kind in named]
    return hashlib.sha256(json.dumps(columns, ensure_ascii=True).encode()).hexdigest()


def packed(spec: str, content: Mapping[str, np.ndarray] | pa.Table, file: str) -> tuple[str, bytes]:
    """The digest of an artifact and the bytes of its file.

    SpecError, which names ``file``, if the content is not what ``data_specs/<spec>.toml`` says.
    """
    rules = load_spec(spec)
    if rules.columns:
        rules.check_table(content, file)
        digest = table_digest(content)
        return digest, encode_table(content, rules, digest)
    arrays = {name: np.asarray(array, order="C") for name, array in content.items()}
    rules.check_arrays(arrays, file)
    digest = arrays_digest(arrays)
    return digest, encode_arrays(arrays, rules, digest)


def encode_arrays(arrays: Mapping[str, np.ndarray], spec: Spec, digest: str = "") -> bytes:
    """An ``.npz`` file whose bytes depend on nothing but the arrays and what made them.

    That is not said of what only passed through (:attr:`slgaussian.storage.provenance.Made.given`).
    """
    buffer = io.BytesIO()
    method = zipfile.ZIP_DEFLATED if spec.compress else zipfile.ZIP_STORED
    about = json.dumps({**spec.about(sorted(arrays)), **statement(digest)}, ensure_ascii=False)
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(_member(ABOUT), about, zipfile.ZIP_DEFLATED, compresslevel=9)
        for name in sorted(arrays):
            member = io.BytesIO()
            np.lib.format.write_array(member, arrays[name], allow_pickle=False)
            archive.writestr(_member(f"{name}.npy"), member.getbuffer(), method, compresslevel=1)
    return buffer.getvalue()


def _member(name: str) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name, _EPOCH)
    info.external_attr = 0o644 << 16
    return info


def encode_table(table: pa.Table, spec: Spec, digest: str = "") -> bytes:
    """A Parquet file of the table, which says what it is and what made it.

    Its own metadata are those of the spec in any case; ``digest`` as :func:`encode_arrays` has it.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    known = spec.schema
    schema = pa.schema([known.field(name) for name in table.column_names], known.metadata)
    table = pa.Table.from_arrays(table.columns, schema=speaking(schema, digest)).combine_chunks()
    buffer = io.BytesIO()
    pq.write_table(table, buffer, compression="zstd")
    return buffer.getvalue()


def decode_table(data: bytes, spec: Spec, file: str, repair: str = REPAIR) -> pa.Table:
    """Read what :func:`encode_table` wrote, or wrote before files said what they are.

    Raises
    ------
    SpecError
        Naming ``file`` and ``repair``, what to do, if the bytes are damaged or cut short, are of
        another spec or a later version of it, or do not hold what ``spec`` says.
    """
    with _whole(data, file, spec, repair):
        table = read_table(data)
        table.validate(full=True)
        label = (table.schema.metadata or {}).get(b"spec", b"").decode() or None
    spec.check_stated(label, file, repair)
    spec.check_table(table, file)
    return table


def decode_arrays(data: bytes, spec: Spec, file: str, repair: str = REPAIR) -> Arrays:
    """Read what :func:`encode_arrays` wrote; SpecError as :func:`decode_table`."""
    with _whole(data, file, spec, repair):
        arrays, about = unpacked(data)
        label = about.get("spec")
    spec.check_stated(label, file, repair)
    spec.check_arrays(arrays, file)
    return arrays


def unpacked(data: bytes) -> tuple[Arrays, dict[str, Any]]:
    """The arrays of what :func:`encode_arrays` wrote and what they say of themselves.

    Nothing, where they were written before they did. Almost any error if it is something else.
    """
    with zipfile.ZipFile(io.BytesIO(data)) as archived:
        if sum(member.file_size for member in archived.infolist()) > MOST_UNPACKED:
            raise ValueError(f"it unpacks to more than {MOST_UNPACKED >> 30} GiB")
    # Not np.load, which takes whatever is no zip file for a pickle and says so.
    with np.lib.npyio.NpzFile(io.BytesIO(data), allow_pickle=False) as archive:
        members: dict[str, Any] = {name: archive[name] for name in archive.files}
    about = strict_json.parse(members.pop(ABOUT, b"{}"))
    if any(isinstance(array, bytes) for array in members.values()):
        raise ValueError("a member is no array")
    if not isinstance(about, dict) or not isinstance(about.get("spec", ""), str):
        raise ValueError(f"{ABOUT} says no spec")
    return members, about


def stated(data: bytes) -> dict[str, Any]:
    """What the bytes of a Parquet or NPZ file say of themselves, without reading what they hold.

    Plain data: ``spec``, ``meaning``, ``made`` ...; nothing where they say nothing. Almost any
    error if they are no such file.
    """
    if data[:4] != b"PAR1":
        with zipfile.ZipFile(io.BytesIO(data)) as members:
            text = members.read(ABOUT) if ABOUT in members.namelist() else b"{}"
        about: dict[str, Any] = strict_json.parse(text)
        return about
    import pyarrow as pa
    import pyarrow.parquet as pq

    metadata = pq.read_schema(pa.BufferReader(data)).metadata or {}
    known = {name.decode(): text.decode() for name, text in metadata.items()}
    return {n: strict_json.parse(text) if n == "made" else text for n, text in known.items()}


def _precedence(data: bytes) -> tuple[bool, str]:
    """What decides between two files of the same content: one that names its maker is first."""
    try:
        made = stated(data).get("made", {})
        return "stage" not in made, json.dumps(made, sort_keys=True)
    except Exception:  # a damaged file raises almost anything
        return True, "~"


@contextmanager
def _whole(data: bytes, file: str, spec: Spec, repair: str) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # a damaged file raises almost anything
        why = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
        found = f"{len(data)} bytes that cannot be read ({why})"
        raise mismatch(file, "file", found, f"a whole {spec.suffix} file; {repair}") from error
