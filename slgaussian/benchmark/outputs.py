"""Output files of a benchmark: tables and masks, which `slgaussian score` can read.

Same results give the same bytes. Costs of answers, which are not reproducible, are in a table of
their own.
"""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import pyarrow as pa

from slgaussian.benchmark.scores import score_table
from slgaussian.checks import name_parts
from slgaussian.errors import InputError
from slgaussian.io import write_atomic
from slgaussian.storage.encoding import encode_table
from slgaussian.storage.specs import load_spec
from slgaussian.storage.tables import read_table

Row = Mapping[str, Any]

_DEVICES = {"CON", "PRN", "AUX", "NUL", *(f"{d}{n}" for d in ("COM", "LPT") for n in range(10))}
"""Reserved file names on Windows, with any suffix."""


def write_samples(rows: Sequence[Row], out: str | Path) -> None:
    """Write ``samples.parquet`` and ``scores.parquet``, of the specs of these names, to ``out``."""
    samples = pa.Table.from_pylist(list(rows), schema=load_spec("samples").schema)
    write_table("samples", samples, out)
    write_table("scores", score_table(rows), out)


def write_costs(rows: Sequence[Row], out: str | Path) -> None:
    """Write ``times.parquet``, the cost of each answer, to ``out``; missing columns are null."""
    schema = load_spec("times").schema
    complete = [{name: row.get(name) for name in schema.names} for row in rows]
    write_table("times", pa.Table.from_pylist(complete, schema=schema), out)


def write_table(name: str, table: pa.Table, out: str | Path) -> None:
    """Write a table of spec ``name`` as ``<name>.parquet`` into folder ``out``.

    Raises SpecError if the table violates its spec.
    """
    file, spec = Path(out) / f"{name}.parquet", load_spec(name)
    spec.check_table(table, str(file))
    write_file(file, encode_table(table, spec))


def write_predictions(
    rows: Sequence[Row], predictions: Mapping[tuple[str, str, str], bytes], out: str | Path
) -> None:
    """Write every mask into folder ``out``, at the path of its row (:func:`mask_paths`).

    ``predictions`` are PNG files by the protocol, frame and query of ``rows``.
    """
    for row, path in zip(rows, mask_paths(rows), strict=True):
        png = predictions.get((row["protocol"], row["frame"], row["query"]))
        if png is not None:
            write_file(Path(out, path), png)


def clear_predictions(rows: Sequence[Row], out: str | Path) -> None:
    """Delete the masks of an earlier run in folder ``out`` that are not in ``rows`` of this run.

    They are those of the earlier ``samples.parquet``, so call this before :func:`write_samples`.
    """
    out = Path(out)
    columns = "method", "protocol", "scene", "frame", "query"
    try:
        earlier = read_table(out / "samples.parquet", columns).to_pylist()
        obsolete = {*mask_paths(earlier)} - {*mask_paths(rows)}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, pa.ArrowException):
        return
    for path in obsolete:
        (out / "predictions" / path).unlink(missing_ok=True)
        for folder in list(path.parents)[:-1]:
            with suppress(OSError):  # not empty, or missing
                (out / "predictions" / folder).rmdir()


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
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, data)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); choose a folder you may write to"
        ) from error
