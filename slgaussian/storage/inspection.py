"""Inspection of files without a store: spec, provenance, digest, damage; ``slgaussian inspect``."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from functools import cache, partial
from pathlib import Path, PurePath
from typing import Any

from safetensors import deserialize

from slgaussian.errors import InputError, SpecError
from slgaussian.formats import strict_json
from slgaussian.storage import encoding
from slgaussian.storage.specs import load_spec, mismatch, parse_label, spec_names

SUFFIXES = (".npz", ".parquet", ".json", ".safetensors")
REPAIR = "download or create it again"


def inspect(place: str | Path) -> Iterator[dict[str, Any]]:
    """Inspect a file, all files of a folder that slgaussian wrote, or the artifacts of a store.

    A store that is not a folder is given by its URL. InputError if there is no such file, or the
    store does not answer.

    Yields rows with ``path``, ``spec``, ``meaning``, ``fields`` (unit and meaning by name),
    ``made`` (provenance in the file) and ``digest``, the SHA-256 of the content of tables and
    arrays, and of other files as a whole. ``problem`` describes damage or a broken spec, else "".
    """
    row = None
    for row in _inspect_store(str(place)) if is_store(place) else _inspect_folder(Path(place)):
        yield row
    if row is None:
        raise InputError(f"{place}: found no file there that slgaussian wrote, expected some")


def is_store(place: str | Path) -> bool:
    """Return whether a place is a URL, or a folder with the records of a store."""
    return "://" in str(place) or (Path(place) / "keys").is_dir()


def summarize(rows: Iterable[Mapping[str, Any]]) -> tuple[list[str], list[Mapping[str, Any]]]:
    """Return the lines of a table of files by stage and spec, and the rows with a problem."""
    counts, bad = Counter[tuple[str, str]](), []
    for row in rows:
        if row["problem"]:
            bad.append(row)
            continue
        made = row["made"]
        version = f" v{made['stage_version']}" if "stage_version" in made else ""
        counts[f"{made.get('stage', 'unknown')}{version}", row["spec"]] += 1
    lines = [f"{'stage':<24}{'spec':<32}{'files':>12}"]
    for (stage, spec), count in sorted(counts.items()):
        lines.append(f"{stage:<24}{spec:<32}{count:>12,}")
    return lines, bad


def _inspect_folder(path: Path) -> Iterator[dict[str, Any]]:
    if not path.is_dir():
        yield _row(str(path), partial(_read, path))
        return
    for file in sorted(path.rglob("*.*")):
        with suppress(InputError):  # skip files of other programs
            yield _row(str(file), partial(_read, file))


def _inspect_store(url: str) -> Iterator[dict[str, Any]]:
    from slgaussian.storage.store import CONCURRENT_READS, ArtifactStore, parse_uri

    store = ArtifactStore(url)

    def inspect_artifact(uri: str) -> dict[str, Any]:
        file = f"{store.root}/{uri}"
        return _row(
            file, lambda: store.fetch(uri, "an artifact", lambda data: _describe(file, data))[1]
        )

    for files in store.walk():
        uris = [file.uri for file in files if parse_uri(file.uri) is not None]
        yield from store.map(inspect_artifact, uris, CONCURRENT_READS)


def _row(file: str, describe: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    row: dict[str, Any] = {"path": file, "spec": "", "meaning": "", "fields": {}}
    row |= {"digest": "", "made": {}, "problem": ""}
    try:
        return row | describe()
    except SpecError as error:
        return row | {"problem": str(error)}


def _read(path: Path) -> dict[str, Any]:
    if path.suffix not in SUFFIXES and path.exists():
        raise InputError(f"{path}: found suffix {path.suffix!r}, expected {', '.join(SUFFIXES)}")
    try:
        return _describe(str(path), path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); expected a file") from error


def _describe(file: str, data: bytes) -> dict[str, Any]:
    path = PurePath(file)
    try:
        if path.suffix == ".safetensors":
            deserialize(data)
            metadata = strict_json.parse(data[8 : 8 + int.from_bytes(data[:8], "little")])
        elif path.suffix in (".npz", ".parquet"):
            metadata = encoding.read_metadata(data)
        else:
            metadata = strict_json.parse(data)
        label = metadata.get("spec", "")
    except Exception as error:  # a damaged file raises almost anything
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
        raise SpecError(f"{file}: is damaged ({reason}); {REPAIR}") from error
    digest, origin = hashlib.sha256(data).hexdigest(), metadata.get("made", {})
    is_artifact = len(path.stem) == len(digest)
    if path.suffix == ".safetensors":
        return {"meaning": "Weights.", "digest": digest, "made": metadata.get("__metadata__", {})}
    by_file = {load_spec(name).file: name for name in spec_names()}
    name = parse_label(label)[0] if label else by_file.get(path.name, "")
    if name not in spec_names() or load_spec(name).suffix != path.suffix:
        refusal = mismatch(file, "spec", f"{label!r:.80}", f"one of {', '.join(spec_names())}")
        raise refusal if label or is_artifact else InputError(str(refusal))
    spec = load_spec(name)
    if path.suffix in (".npz", ".parquet"):
        digest, _ = encoding.decode_artifact(data, spec, file, REPAIR)
    else:
        keys = ("made_by", "slgaussian", "command", "settings")
        origin = {key: metadata[key] for key in keys if key in metadata}
    if is_artifact and path.stem != digest:
        raise mismatch(file, "digest", digest[:12], "that of its name")
    return {**_describe_spec(name), "digest": digest, "made": origin}


@cache  # a store has many files of a spec
def _describe_spec(name: str) -> dict[str, Any]:
    spec = load_spec(name)
    entries = {**spec.fields, **spec.columns, **spec.keys}
    fields = {name: f"[{entry.unit or entry.type}] {entry.doc}" for name, entry in entries.items()}
    return {"spec": spec.label, "meaning": spec.doc, "fields": fields}
