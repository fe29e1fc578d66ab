"""Output files of a benchmark: tables, also of masks, which `slgaussian score` can read.

Same results give the same bytes. Costs of answers, which are not reproducible, are in a table of
their own.
"""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from slgaussian.benchmark.pictures import encode_png
from slgaussian.benchmark.scores import Rows, score_table
from slgaussian.checks import name_parts
from slgaussian.errors import InputError
from slgaussian.formats.rle import RunLengths
from slgaussian.io import atomic_path, write_atomic
from slgaussian.storage.encoding import decode_table, encode_table
from slgaussian.storage.provenance import with_provenance
from slgaussian.storage.specs import load_spec

Row = Mapping[str, Any]
Masks = Mapping[tuple[str, str, str], RunLengths]
"""Masks by protocol (name@version), frame and query."""

MASKS_IN_MEMORY = 10_000
"""Number of masks that are written at once."""

REPAIR = "run the command again that wrote it"

_DEVICES = {"CON", "PRN", "AUX", "NUL", *(f"{d}{n}" for d in ("COM", "LPT") for n in range(10))}
"""Reserved file names on Windows, with any suffix."""


def write_samples(rows: Rows, out: str | Path) -> None:
    """Write ``samples.parquet`` and ``scores.parquet``, of the specs of these names, to ``out``."""
    write_table("samples", rows.table, out)
    write_table("scores", score_table(rows), out)


def write_table(name: str, table: pa.Table, out: str | Path) -> None:
    """Write a table of spec ``name`` as ``<name>.parquet`` into folder ``out``.

    Raises SpecError if the table violates its spec.
    """
    file, spec = Path(out) / f"{name}.parquet", load_spec(name)
    spec.check_table(table, str(file))
    write_file(file, encode_table(table, spec))


def write_masks(masks: Iterable[tuple[str, str, Masks]], out: str | Path) -> None:
    """Write masks of methods and scenes, by these names, as ``masks.parquet`` into folder ``out``.

    Spec ``masks``. :data:`MASKS_IN_MEMORY` are in memory. InputError if it cannot be written.
    """
    spec = load_spec("masks")
    file, schema = Path(out) / spec.file, with_provenance(spec.schema)
    rows = (
        {"method": method, "protocol": protocol, "scene": scene, "frame": frame, "query": query}
        | mask._asdict()
        for method, scene, of_scene in masks
        for (protocol, frame, query), mask in of_scene.items()
    )
    with (
        _writing(file),
        atomic_path(file) as temporary,
        pq.ParquetWriter(temporary, schema, compression="zstd") as writer,
    ):
        while part := list(islice(rows, MASKS_IN_MEMORY)):
            table = pa.Table.from_pylist(part, schema=schema)
            spec.check_table(table, str(file))
            writer.write_table(table)


def export_masks(file: Path, out: Path) -> int:
    """Write the masks of a ``masks.parquet`` as PNG files into folder ``out``; return their number.

    At :func:`mask_paths`, one bit per pixel. InputError if they cannot be read or written.
    """
    rows = read_masks(file)
    for row, path in zip(rows, mask_paths(rows), strict=True):
        write_file(out / path, encode_png(row["mask"].decode()))
    return len(rows)


def read_masks(file: Path) -> list[dict[str, Any]]:
    """Read a ``masks.parquet`` as rows with ``mask`` in place of the columns of run lengths.

    InputError if it cannot be read.
    """
    try:
        rows = decode_table(file.read_bytes(), load_spec("masks"), str(file), REPAIR).to_pylist()
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); expected masks") from error
    return [row | {"mask": RunLengths(*map(row.pop, RunLengths._fields))} for row in rows]


def mask_paths(rows: Sequence[Row]) -> list[Path]:
    """Return the path ``<method>/<protocol>/<scene>/<frame>/<query>.png`` of the mask of each row.

    The protocol has no version, the frame no suffix, and its folders only if another frame of the
    scene has the same file name; names are :func:`file_name`.
    """
    frames = {(row["scene"], name_parts(row["frame"])) for row in rows}
    count = Counter((scene, parts[-1]) for scene, parts in frames)
    paths = []
    for row in rows:
        protocol, parts = row["protocol"].partition("@")[0], name_parts(row["frame"])
        frame = "/".join(parts) if count[row["scene"], parts[-1]] > 1 else parts[-1]
        folder = map(file_name, (row["method"], protocol, row["scene"], frame))
        paths.append(Path(*folder, f"{file_name(row['query'])}.png"))
    return paths


def file_name(text: str) -> str:
    """Return a file name for any text: ASCII letters, digits, space, ``.``, ``-`` and ``_``.

    A text of these characters is unchanged; any other gets a hash as suffix.
    """
    safe = re.sub(r"[^A-Za-z0-9._ -]+", "_", text).strip(" .")[:80]
    if safe.partition(".")[0].upper() in _DEVICES:
        safe = f"_{safe}"
    if safe and safe == text:
        return safe
    return f"{safe}-{hashlib.sha256(text.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"


def write_file(path: Path, data: bytes) -> None:
    """Write a file, and create its folders; InputError if it cannot be written."""
    with _writing(path):
        write_atomic(path, data)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); choose a folder you may write to"
        ) from error
