"""Content-addressed artifacts: arrays and tables on any file system, written whole or not at all.

The same content has the same digest, the same path and, within one version of NumPy, zlib and
Arrow, the same bytes. The digest is over the content and not over the file, so it outlives those
versions.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import uuid
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import fsspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from fsspec.implementations.local import LocalFileSystem

from data_specs import Spec, load_spec, mismatch
from slgaussian.errors import InputError

Arrays = dict[str, np.ndarray]

_EPOCH = (
    1980,
    1,
    1,
    0,
    0,
    0,
)  # the earliest time a zip can hold; a real one would change the bytes
REPAIR = "delete the file and run again to have it made anew"
"""What to do about a damaged artifact."""


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


class ArtifactStore:
    """Artifacts under one root, at ``<spec>/<aa>/<digest>.npz`` or ``.parquet``.

    Parameters
    ----------
    root : str or path
        A folder or any fsspec URL (``memory://x``, ``s3://bucket/prefix``). Made when first
        written to.

    Raises
    ------
    InputError
        If fsspec does not know the URL, or lacks the package that speaks its protocol.
    """

    def __init__(self, root: str | os.PathLike[str] = "./slg-data") -> None:
        try:
            self.fs, self.path = fsspec.core.url_to_fs(os.fspath(root))
        except (ImportError, ValueError) as error:
            raise InputError(f"store {root}: {error}; or choose a folder with --store") from error
        self.local = isinstance(self.fs, LocalFileSystem)
        self.root = self.path if self.local else os.fspath(root).rstrip("/")

    def put(
        self, spec: str, content: Mapping[str, np.ndarray] | pa.Table, meta: dict | None = None
    ) -> ArtifactRef:
        """Write an artifact and return its ref; the same content twice is one file.

        Raises
        ------
        SpecError
            If the content is not what ``data_specs/<spec>.toml`` says.
        InputError
            If the store cannot be written to.
        """
        rules = load_spec(spec)
        label = f"new {spec} artifact"
        if rules.columns:
            rules.check_table(content, label)
            digest, data = table_digest(content), encode_table(content)
        else:
            arrays = {name: np.asarray(array, order="C") for name, array in content.items()}
            rules.check_arrays(arrays, label)
            digest, data = arrays_digest(arrays), encode_arrays(arrays, rules.compress)
        uri = f"{spec}/{digest[:2]}/{digest}{rules.suffix}"
        self.write(uri, data)
        return ArtifactRef(spec, uri, digest, dict(meta or {}))

    def get(self, ref: ArtifactRef) -> Arrays | pa.Table:
        """Read an artifact, checked against its spec and its digest.

        Raises
        ------
        SpecError
            If the file is missing, cut short, altered or not what the spec says: one sentence
            with the file, the field, what was found and what was expected.
        """
        rules = load_spec(ref.spec)
        file = f"{self.root}/{ref.uri}"
        try:
            data = self.fs.cat_file(f"{self.path}/{ref.uri}")
        except FileNotFoundError:
            raise mismatch(file, "file", "nothing", f"a {ref.spec} artifact") from None
        except OSError as error:
            raise mismatch(file, "file", str(error), "a readable file") from error
        content = decode(data, rules, file)
        if rules.columns:
            rules.check_table(content, file)
            digest = table_digest(content)
        else:
            rules.check_arrays(content, file)
            digest = arrays_digest(content)
        if digest != ref.digest:
            found, expected = f"content {digest[:12]}", f"{ref.digest[:12]}; {REPAIR}"
            raise mismatch(file, "digest", found, expected)
        return content

    def check_there(self, uri: str) -> None:
        """Raise :class:`SpecError` if there is no file at a path relative to the root."""
        if not self.fs.exists(f"{self.path}/{uri}"):
            raise mismatch(f"{self.root}/{uri}", "file", "nothing", "an artifact")

    def check_writable(self) -> None:
        """Raise :class:`InputError` now rather than after the work if nothing can be written."""
        probe = f".probe-{uuid.uuid4().hex}"
        self.write(probe, b"")
        self.fs.rm_file(f"{self.path}/{probe}")

    def write(self, uri: str, data: bytes) -> None:
        """Write a file that is no artifact, whole or not at all; InputError if that fails."""
        path = f"{self.path}/{uri}"
        try:
            self.fs.makedirs(path.rsplit("/", 1)[0], exist_ok=True)
            if self.local:
                write_atomic(path, data)
            else:
                self.fs.pipe_file(path, data)  # one put: object stores show it whole or not at all
        except OSError as error:
            raise InputError(
                f"store {self.root}: cannot write there ({error.strerror or error}); choose a "
                "writable folder with --store"
            ) from error


def write_atomic(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a local file so that no reader, and no crash, ever sees a part of it."""
    with replacing(path) as temporary, open(temporary, "wb") as file:
        file.write(data)


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[str]:
    """A name to write a local file under, which takes the place of ``path`` once it is whole."""
    folder, name = os.path.split(os.fspath(path))
    temporary = os.path.join(folder, f".{name}.{uuid.uuid4().hex[:8]}.tmp")
    try:
        yield temporary
        os.replace(temporary, path)
    except BaseException:
        if os.path.exists(temporary):
            os.remove(temporary)
        raise


def sha256_of(file: str | os.PathLike[str]) -> str:
    """SHA-256 of a local file's content, hexadecimal."""
    with open(file, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def arrays_digest(arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 over (name, dtype, shape, C-order bytes) of the arrays in order of their names."""
    sha = hashlib.sha256()
    for name in sorted(arrays):
        array = np.asarray(arrays[name], order="C")
        sha.update(f"{name}\0{array.dtype.str}\0{array.shape}\0".encode())
        sha.update(array.reshape(-1).view(np.uint8))
    return sha.hexdigest()


def table_digest(table: pa.Table) -> str:
    """SHA-256 over the column names, types and values of a table, whatever its chunks."""
    columns = [[f.name, str(f.type), table.column(f.name).to_pylist()] for f in table.schema]
    return hashlib.sha256(json.dumps(columns, ensure_ascii=True).encode()).hexdigest()


def encode_arrays(arrays: Mapping[str, np.ndarray], compress: bool) -> bytes:
    """An ``.npz`` file whose bytes depend on nothing but the arrays."""
    buffer = io.BytesIO()
    method = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in sorted(arrays):
            member = io.BytesIO()
            np.lib.format.write_array(member, arrays[name], allow_pickle=False)
            info = zipfile.ZipInfo(f"{name}.npy", _EPOCH)
            info.external_attr = 0o644 << 16
            archive.writestr(info, member.getbuffer(), method, compresslevel=1)
    return buffer.getvalue()


def encode_table(table: pa.Table) -> bytes:
    """A Parquet file of the table."""
    buffer = io.BytesIO()
    pq.write_table(table.combine_chunks(), buffer, compression="zstd")
    return buffer.getvalue()


def decode(data: bytes, spec: Spec, file: str, repair: str = REPAIR) -> Arrays | pa.Table:
    """Read what :func:`encode_arrays` or :func:`encode_table` wrote.

    Raises
    ------
    SpecError
        Naming ``file`` and ``repair``, what to do, if the bytes are damaged or cut short.
    """
    try:
        if spec.columns:
            table = pq.read_table(io.BytesIO(data))
            table.validate(full=True)
            return table
        # Not np.load, which takes whatever is no zip file for a pickle and says so.
        with np.lib.npyio.NpzFile(io.BytesIO(data), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (
        OSError,
        ValueError,
        EOFError,
        KeyError,
        MemoryError,  # a damaged length
        RuntimeError,  # damaged flags: encrypted, or by a method not implemented
        zipfile.BadZipFile,
        zlib.error,
        pa.ArrowInvalid,
    ) as error:
        found = f"{len(data)} bytes that cannot be read ({error})"
        raise mismatch(file, "file", found, f"a whole {spec.suffix} file; {repair}") from error
