"""Inspection of files without a store: spec, provenance, digest, damage; ``slgaussian inspect``."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from safetensors import deserialize

from slgaussian.errors import InputError, SpecError
from slgaussian.formats import strict_json
from slgaussian.storage import encoding
from slgaussian.storage.specs import load_spec, mismatch, parse_label, spec_names

SUFFIXES = (".npz", ".parquet", ".json", ".safetensors")
REPAIR = "download or create it again"


def inspect(path: Path) -> list[dict[str, Any]]:
    """Inspect a file, or all files of a folder that slgaussian wrote; InputError if there is none.

    Returns rows with ``path``, ``spec``, ``meaning``, ``fields`` (unit and meaning by name),
    ``made`` (provenance in the file) and ``digest``, the SHA-256 of the content of tables and
    arrays, and of other files as a whole. ``problem`` describes damage or a broken spec, else "".
    """
    files = sorted(path.rglob("*.*")) if path.is_dir() else [path]
    inspected = []
    for file in files:
        row: dict[str, Any] = {"path": str(file), "spec": "", "meaning": "", "fields": {}}
        row |= {"digest": "", "made": {}, "problem": ""}
        try:
            inspected.append(row | _read(file))
        except SpecError as error:
            inspected.append(row | {"problem": str(error)})
        except InputError:
            if not path.is_dir():  # in a folder, skip files of other programs
                raise
    if not inspected:
        raise InputError(f"{path}: found no file there that slgaussian wrote, expected some")
    return inspected


def _read(path: Path) -> dict[str, Any]:
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: found suffix {path.suffix!r}, expected {', '.join(SUFFIXES)}")
    try:
        data = path.read_bytes()
        if path.suffix == ".safetensors":
            deserialize(data)
            metadata = strict_json.parse(data[8 : 8 + int.from_bytes(data[:8], "little")])
        elif path.suffix in (".npz", ".parquet"):
            metadata = encoding.read_metadata(data)
        else:
            metadata = strict_json.parse(data)
        label = metadata.get("spec", "")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); expected a file") from error
    except Exception as error:  # a damaged file raises almost anything
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
        raise SpecError(f"{path}: is damaged ({reason}); {REPAIR}") from error
    file, digest, origin = str(path), hashlib.sha256(data).hexdigest(), metadata.get("made", {})
    if path.suffix == ".safetensors":
        return {"meaning": "Weights.", "digest": digest, "made": metadata.get("__metadata__", {})}
    by_file = {load_spec(name).file: name for name in spec_names()}
    name = parse_label(label)[0] if label else by_file.get(path.name, "")
    if name not in spec_names() or load_spec(name).suffix != path.suffix:
        refusal = mismatch(file, "spec", f"{label!r:.80}", f"one of {', '.join(spec_names())}")
        raise refusal if label else InputError(str(refusal))
    spec = load_spec(name)
    if path.suffix == ".npz":
        digest = encoding.arrays_digest(encoding.decode_arrays(data, spec, file, REPAIR))
    elif path.suffix == ".parquet":
        digest = encoding.table_digest(encoding.decode_table(data, spec, file, REPAIR))
    else:
        keys = ("made_by", "slgaussian", "command", "settings")
        origin = {key: metadata[key] for key in keys if key in metadata}
    if len(path.stem) == len(digest) and path.stem != digest:
        raise mismatch(file, "digest", digest[:12], "that of its name")
    entries = {**spec.fields, **spec.columns, **spec.keys}
    fields = {name: f"[{entry.unit or entry.type}] {entry.doc}" for name, entry in entries.items()}
    row = {"spec": spec.label, "meaning": spec.doc, "fields": fields}
    return {**row, "digest": digest, "made": origin}
