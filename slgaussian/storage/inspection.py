"""Spec, fields, units and origin of files, from the files alone: for ``slgaussian inspect``."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian.errors import InputError, SpecError
from slgaussian.formats import strict_json
from slgaussian.formats.ply import load_ply
from slgaussian.formats.spz import load_spz
from slgaussian.storage.documents import read_document
from slgaussian.storage.specs import Spec, load_spec, mismatch, parse_label, spec_names
from slgaussian.storage.store import arrays_digest, is_digest, stated, table_digest, unpacked
from slgaussian.storage.tables import read_table


@dataclass(frozen=True)
class Inspected:
    """A file: its data spec, what made it, and a row a field: name, type, unit and meaning.

    ``digest`` is the SHA-256 of what a table or arrays hold, of other files themselves. ``problem``
    says in which way the file is not what its spec asks; it is empty if it is.
    """

    path: str
    spec: str = ""
    meaning: str = ""
    digest: str = ""
    problem: str = ""
    fields: tuple[Mapping[str, str], ...] = ()
    made: Mapping[str, Any] = field(default_factory=dict)


def inspect(path: str | Path) -> list[Inspected]:
    """Inspect a file, or each file of a folder that says what it is.

    Raises
    ------
    InputError
        If there is nothing, or nothing that slgaussian writes.
    """
    path = Path(path)
    if not path.is_dir():
        return [_inspect(path)]
    holds = []
    for file in sorted(file for file in path.rglob("*") if file.suffix in READERS):
        try:
            holds.append(_inspect(file))
        except InputError:  # somebody else's, such as the index that a run was given
            continue
    if not holds:
        raise InputError(f"{path}: found no file there that slgaussian wrote, expected some")
    return holds


def _inspect(path: Path) -> Inspected:
    if path.suffix not in READERS:
        raise InputError(f"{path}: found suffix {path.suffix!r}, expected {', '.join(READERS)}")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); expected a file") from error
    try:
        found = READERS[path.suffix](path, data)
    except SpecError as error:
        return Inspected(str(path), problem=str(error))
    except InputError:
        raise
    except Exception as error:  # a damaged file raises almost anything
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
        problem = f"{path}: is damaged ({reason}); fetch or make it again"
        return Inspected(str(path), problem=problem)
    if is_digest(path.stem) and path.stem != found.digest:
        problem = f"{path}: digest: found {found.digest[:12]}, expected that of its name"
        return Inspected(str(path), found.spec, problem=problem)
    return found


def _spec_of(label: Any, path: Path) -> Spec:
    """Return the spec that a file names, or that its place or name tells."""
    by_file = {load_spec(name).file: name for name in spec_names() if load_spec(name).file}
    folder = path.parents[1].name if is_digest(path.stem) else path.stem
    name = by_file.get(path.name, folder) if label is None else parse_label(str(label))[0]
    if name in spec_names() and load_spec(name).suffix == path.suffix:
        spec = load_spec(name)
        if label is not None:
            spec.check_stated(str(label), str(path), "make it again")
        return spec
    if label is not None:
        raise mismatch(str(path), "spec", f"{label!r:.80}", f"one of {', '.join(spec_names())}")
    raise InputError(
        f"{path}: names no data spec, and neither does its name tell one: slgaussian did not write "
        "it, or wrote it before files said what they are; rename it as it was called, if so"
    )


def _fields(types: Mapping[str, str], known: Mapping[str, Any]) -> tuple[Mapping[str, str], ...]:
    entries = {name: known.get(name) for name in types}
    return tuple(
        {"name": n, "type": types[n], "unit": e.unit if e else "", "meaning": e.doc if e else ""}
        for n, e in entries.items()
    )


def _arrays(path: Path, data: bytes) -> Inspected:
    arrays, about = unpacked(data)
    spec = _spec_of(about.get("spec"), path)
    spec.check_arrays(arrays, str(path))
    fields = _fields(_types(arrays), spec.fields)
    digest = arrays_digest(arrays)
    return Inspected(str(path), spec.label, spec.doc, digest, "", fields, about.get("made", {}))


def _types(arrays: Mapping[str, np.ndarray]) -> dict[str, str]:
    return {name: f"{a.dtype.name} {list(a.shape)}" for name, a in arrays.items()}


def _table(path: Path, data: bytes) -> Inspected:
    about, table = stated(data), read_table(data)
    spec = _spec_of(about.get("spec"), path)
    spec.check_table(table, str(path))
    types = {c.name: f"{c.type} [{table.num_rows}]" for c in table.schema}
    fields, digest = _fields(types, spec.columns), table_digest(table)
    return Inspected(str(path), spec.label, spec.doc, digest, "", fields, about.get("made", {}))


def _document(path: Path, data: bytes) -> Inspected:
    about = strict_json.parse(data.split(b"\n", 1)[0] if path.suffix == ".jsonl" else data)
    spec = _spec_of(about.get("spec"), path)
    read_document(data, spec, str(path))
    types = {name: key.type for name, key in spec.keys.items() if name in about}
    made = {key: about[key] for key in ("made_by", "slgaussian", "command") if key in about}
    made |= {"settings": about["settings"]} if "settings" in about else {}
    fields, digest = _fields(types, spec.keys), hashlib.sha256(data).hexdigest()
    return Inspected(str(path), spec.label, spec.doc, digest, "", fields, made)


def _tensors(path: Path, data: bytes) -> Inspected:
    length = int.from_bytes(data[:8], "little")
    header = strict_json.parse(data[8 : 8 + length])
    about = header.pop("__metadata__", {})
    end = 8 + length + max(one["data_offsets"][1] for one in header.values())
    if end != len(data):
        raise ValueError(f"found {len(data)} bytes, expected {end}")
    types = {name: f"{one['dtype']} {one['shape']}" for name, one in sorted(header.items())}
    made = strict_json.parse(about["slgaussian"]) if "slgaussian" in about else about
    digest = hashlib.sha256(data).hexdigest()
    return Inspected(str(path), "", "Weights.", digest, "", _fields(types, {}), {"settings": made})


def _gaussians(path: Path, data: bytes) -> Inspected:
    gaussians = load_spz(path) if path.suffix == ".spz" else load_ply(path)[0]
    fields = _fields(_types(gaussians.to_arrays()), load_spec("gaussians").fields)
    digest = hashlib.sha256(data).hexdigest()
    return Inspected(str(path), "", "Gaussians, as they are read.", digest, "", fields)


READERS: Mapping[str, Callable[[Path, bytes], Inspected]] = {
    ".npz": _arrays,
    ".parquet": _table,
    ".json": _document,
    ".jsonl": _document,
    ".safetensors": _tensors,
    ".ply": _gaussians,
    ".spz": _gaussians,
}
