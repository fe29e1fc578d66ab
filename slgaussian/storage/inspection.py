"""Spec, origin and digest of files, from the files alone, and one check: ``slgaussian inspect``."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from safetensors import deserialize

from slgaussian.errors import InputError, SpecError
from slgaussian.formats import strict_json
from slgaussian.formats.ply import load_ply
from slgaussian.formats.spz import load_spz
from slgaussian.storage.documents import read_document
from slgaussian.storage.encoding import (
    arrays_digest,
    decode_arrays,
    decode_table,
    stated,
    table_digest,
)
from slgaussian.storage.specs import load_spec, mismatch, parse_label, spec_names
from slgaussian.storage.store import is_digest

SUFFIXES = (".npz", ".parquet", ".json", ".jsonl", ".safetensors", ".ply", ".spz")
REPAIR = "fetch or make it again"


@dataclass(frozen=True)
class Inspected:
    """A file: its data spec, what it says that made it, and its digest.

    ``digest`` is the SHA-256 of the content of a table or arrays, of other files themselves.
    ``problem`` says in which way the file is damaged or not what its spec asks; else it is empty.
    """

    path: str
    spec: str = ""
    meaning: str = ""
    digest: str = ""
    problem: str = ""
    made: Mapping[str, Any] = field(default_factory=dict)


def inspect(path: Path) -> list[Inspected]:
    """Inspect a file, or each file of a folder that slgaussian wrote; InputError if none is."""
    if not path.is_dir():
        return [_inspect_file(path)]
    inspected = []
    for file in sorted(file for file in path.rglob("*") if file.suffix in SUFFIXES):
        try:
            inspected.append(_inspect_file(file))
        except InputError:  # somebody else's, such as the index that a run was given
            continue
    if not inspected:
        raise InputError(f"{path}: found no file there that slgaussian wrote, expected some")
    return inspected


def _inspect_file(path: Path) -> Inspected:
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: found suffix {path.suffix!r}, expected {', '.join(SUFFIXES)}")
    try:
        return _read(path, path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); expected a file") from error
    except SpecError as error:
        return Inspected(str(path), problem=str(error))
    except InputError:
        raise
    except Exception as error:  # a damaged file raises almost anything
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
        return Inspected(str(path), problem=f"{path}: is damaged ({reason}); {REPAIR}")


def _read(path: Path, data: bytes) -> Inspected:
    file, digest = str(path), hashlib.sha256(data).hexdigest()
    if path.suffix in (".ply", ".spz"):
        load_ply(path) if path.suffix == ".ply" else load_spz(path)
        return Inspected(file, "", "Gaussians.", digest)
    if path.suffix == ".safetensors":
        deserialize(data)
        header = strict_json.parse(data[8 : 8 + int.from_bytes(data[:8], "little")])
        return Inspected(file, "", "Weights.", digest, made=header.get("__metadata__", {}))
    if path.suffix in (".json", ".jsonl"):
        about = strict_json.parse(data.split(b"\n", 1)[0] if path.suffix == ".jsonl" else data)
    else:
        about = stated(data)
    by_file = {load_spec(name).file: name for name in spec_names()}
    label = about.get("spec", by_file.get(path.name, ""))
    spec_name = parse_label(label)[0]
    if spec_name not in spec_names() or load_spec(spec_name).suffix != path.suffix:
        error = mismatch(file, "spec", f"{label!r:.80}", f"one of {', '.join(spec_names())}")
        raise error if label else InputError(str(error))
    spec, made = load_spec(spec_name), about.get("made", {})
    if path.suffix == ".npz":
        digest = arrays_digest(decode_arrays(data, spec, file, REPAIR))
    elif path.suffix == ".parquet":
        digest = table_digest(decode_table(data, spec, file, REPAIR))
    else:
        read_document(data, spec, file)
        keys = ("made_by", "slgaussian", "command", "settings")
        made = {key: about[key] for key in keys if key in about}
    if is_digest(path.stem) and path.stem != digest:
        raise mismatch(file, "digest", digest[:12], "that of its name")
    return Inspected(file, spec.label, spec.doc, digest, made=made)
