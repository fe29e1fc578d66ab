"""Encoding of arrays and tables as files, with content digests and metadata.

A digest is computed over the content, not over the bytes of the file. Those also depend on the
versions of NumPy, zlib and Arrow and contain the provenance of the file
(:mod:`slgaussian.storage.provenance`); the digest does not.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slgaussian.formats import strict_json
from slgaussian.io import write_atomic
from slgaussian.storage.provenance import provenance_metadata, with_provenance
from slgaussian.storage.specs import METADATA_FILE, Spec, load_spec, mismatch
from slgaussian.storage.tables import MAX_UNPACKED_BYTES, read_table

if TYPE_CHECKING:  # a field is read without Arrow, which takes long to import
    import pyarrow as pa

Arrays = dict[str, np.ndarray]

REPAIR = "delete the file and run again to recompute it"
"""Advice in messages about a damaged artifact."""

_EPOCH = (1980, 1, 1, 0, 0, 0)  # earliest time of a zip member; constant, for the same bytes


def arrays_digest(arrays: Mapping[str, np.ndarray]) -> str:
    """Return the SHA-256 over (name, dtype, shape, C-order bytes) of arrays in order of names."""
    sha = hashlib.sha256()
    for name in sorted(arrays):
        array = np.asarray(arrays[name], order="C")
        sha.update(f"{name}\0{array.dtype.str}\0{array.shape}\0".encode())
        sha.update(array.reshape(-1).view(np.uint8).data)
    return sha.hexdigest()


def table_digest(table: pa.Table) -> str:
    """Return the SHA-256 over names, types and values of the columns, independent of chunks."""
    # Parquet calls the field of a list type "element", Arrow calls it "item".
    types = [str(f.type).replace("list<element:", "list<item:") for f in table.schema]
    named = zip(table.schema.names, types, strict=True)
    columns = [[name, kind, table.column(name).to_pylist()] for name, kind in named]
    return hashlib.sha256(json.dumps(columns, ensure_ascii=True).encode()).hexdigest()


def encode_artifact(
    spec: str, content: Mapping[str, np.ndarray] | pa.Table, file: str
) -> tuple[str, bytes]:
    """Return the digest of an artifact and the bytes of its file.

    SpecError, which names ``file``, if the content breaks ``data_specs/<spec>.toml``.
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
    """Return an ``.npz`` file whose bytes depend only on the arrays and their provenance.

    Content that a stage passes through unchanged does not name that stage
    (:class:`slgaussian.storage.provenance.Provenance`).
    """
    buffer = io.BytesIO()
    method = zipfile.ZIP_DEFLATED if spec.compress else zipfile.ZIP_STORED
    metadata = json.dumps(
        {**spec.about(sorted(arrays)), **provenance_metadata(digest)}, ensure_ascii=False
    )
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(_member(METADATA_FILE), metadata, zipfile.ZIP_DEFLATED, compresslevel=9)
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
    """Return a Parquet file of the table, with its spec and provenance as metadata.

    The metadata of the given table are dropped. ``digest`` is that of the content.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    rules = spec.schema
    schema = pa.schema([rules.field(name) for name in table.column_names], rules.metadata)
    table = pa.Table.from_arrays(
        table.columns, schema=with_provenance(schema, digest)
    ).combine_chunks()
    buffer = io.BytesIO()
    pq.write_table(table, buffer, compression="zstd")
    return buffer.getvalue()


def decode_artifact(
    data: bytes, spec: Spec, file: str, repair: str = REPAIR
) -> tuple[str, Arrays | pa.Table]:
    """Return the digest and the content of an artifact; SpecError as in :func:`decode_table`."""
    if spec.columns:
        table = decode_table(data, spec, file, repair)
        return table_digest(table), table
    arrays = decode_arrays(data, spec, file, repair)
    return arrays_digest(arrays), arrays


def save_table(file: Path, table: pa.Table, spec: str) -> None:
    """Write a table to a local file as :func:`encode_table`; OSError if that fails."""
    write_atomic(file, encode_table(table, load_spec(spec)))


def load_table(file: Path, spec: str, repair: str) -> pa.Table:
    """Read a local file as :func:`decode_table`; OSError if it cannot be read."""
    return decode_table(file.read_bytes(), load_spec(spec), str(file), repair)


def decode_table(data: bytes, spec: Spec, file: str, repair: str = REPAIR) -> pa.Table:
    """Read a table of :func:`encode_table`.

    Raises:
        SpecError: If the bytes are damaged or truncated, have another spec or version of it, or
            break ``spec``. The message names ``file`` and gives the advice ``repair``.
    """
    with _explain_damage(data, file, spec, repair):
        table = read_table(data)
        table.validate(full=True)
        label = (table.schema.metadata or {}).get(b"spec", b"").decode() or None
    spec.check_label(label, file, repair)
    spec.check_table(table, file)
    return table


def decode_arrays(data: bytes, spec: Spec, file: str, repair: str = REPAIR) -> Arrays:
    """Read arrays of :func:`encode_arrays`; SpecError as in :func:`decode_table`."""
    with _explain_damage(data, file, spec, repair):
        arrays, metadata = decode_npz(data)
    spec.check_label(metadata.get("spec"), file, repair)
    spec.check_arrays(arrays, file)
    return arrays


def decode_npz(data: bytes) -> tuple[Arrays, dict[str, Any]]:
    """Return arrays and metadata of an ``.npz`` file; raises any exception for other data."""
    with zipfile.ZipFile(io.BytesIO(data)) as archived:
        if sum(member.file_size for member in archived.infolist()) > MAX_UNPACKED_BYTES:
            raise ValueError(f"it unpacks to more than {MAX_UNPACKED_BYTES >> 30} GiB")
    # Not np.load, which takes a file that is no zip archive for a pickle.
    with np.lib.npyio.NpzFile(io.BytesIO(data), allow_pickle=False) as archive:
        members: dict[str, Any] = {name: archive[name] for name in archive.files}
    metadata = strict_json.parse(members.pop(METADATA_FILE, b"{}"))
    if any(isinstance(array, bytes) for array in members.values()):
        raise ValueError("a member is not an array")
    if not isinstance(metadata, dict) or not isinstance(metadata.get("spec", ""), str):
        raise ValueError(f"{METADATA_FILE} names no spec")
    return members, metadata


def read_metadata(data: bytes) -> dict[str, Any]:
    """Return the metadata of a Parquet or NPZ file, without reading its content.

    Plain data: ``spec``, ``meaning``, ``made`` ...; empty for files of other programs. Raises any
    exception for other data.
    """
    if data[:4] != b"PAR1":
        with zipfile.ZipFile(io.BytesIO(data)) as members:
            text = members.read(METADATA_FILE) if METADATA_FILE in members.namelist() else b"{}"
        parsed: dict[str, Any] = strict_json.parse(text)
        return parsed
    import pyarrow as pa
    import pyarrow.parquet as pq

    metadata = pq.read_schema(pa.BufferReader(data)).metadata or {}
    entries = {name.decode(): text.decode() for name, text in metadata.items()}
    return {n: strict_json.parse(text) if n == "made" else text for n, text in entries.items()}


@contextmanager
def _explain_damage(data: bytes, file: str, spec: Spec, repair: str) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # a damaged file raises almost anything
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
        problem = f"{len(data)} bytes that cannot be read ({reason})"
        raise mismatch(file, "file", problem, f"a complete {spec.suffix} file; {repair}") from error
