"""Versions of a training set: a manifest each, ``versions/000003.json`` (spec ``set_version``).

A version is a change of the content, the settings or the shards. Manifests have no time, so the
same input gives the same bytes. The manifest is written before the index: after a crash between
them it describes an index that was never there, and the next run adds another.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from slgaussian.benchmark.reports.model import count_text
from slgaussian.datasets.shards import Written
from slgaussian.errors import SpecError
from slgaussian.formats import strict_json
from slgaussian.io import write_atomic
from slgaussian.storage.provenance import provenance_metadata
from slgaussian.storage.specs import load_spec

FOLDER = "versions"
CONTENT = ("sample", "digest", "split", "place")
"""Columns of the index that are the content of a set, whatever its shards."""

Manifest = dict[str, Any]


def digest_content(index: pa.Table) -> str:
    """Return the SHA-256 over samples, their digests, splits and places, hexadecimal."""
    rows = sorted(zip(*(index[name].to_pylist() for name in CONTENT), strict=True))
    return hashlib.sha256(json.dumps(rows).encode()).hexdigest()


def read_versions(out: Path) -> list[Manifest]:
    """Read all manifests of a set, the oldest first; SpecError if one is damaged."""
    manifests, label = [], load_spec("set_version").label
    for file in sorted((out / FOLDER).glob("[0-9]*.json")):
        try:
            manifests.append(strict_json.parse(file.read_bytes()))
            if manifests[-1]["spec"] != label or manifests[-1]["version"] != int(file.stem):
                raise ValueError(f"it is no {label} of this number")
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise SpecError(f"{file}: cannot be read ({error}); restore or remove it") from error
    return manifests


def add_version(
    out: Path,
    before: pa.Table,
    written: Written,
    settings: Mapping[str, Any],
    withdrawn: Collection[str] = (),
    refused: Mapping[str, str] | None = None,
    present: Collection[str] = (),
) -> Manifest:
    """Write the manifest of a set that changes from an index to another; return it.

    If content, settings and shards are those of the last version, that one is returned.

    Args:
        withdrawn: Clips that may no longer be used.
        refused: Reasons by clip or sample.
        present: Clips that the sources have.

    Raises:
        SpecError: If an earlier manifest is damaged.
        OSError: If the file cannot be written.
    """
    history, plain = read_versions(out), json.loads(json.dumps(settings))
    last = history[-1] if history else {"version": 0, "settings": plain}
    digest = digest_content(written.index)
    state = {"digest": digest, "settings": plain, "shards": written.shards}
    if all(last.get(name) == value for name, value in state.items()):
        return last
    old = last["settings"]
    differ = sorted(name for name in {*old, *plain} if old.get(name) != plain.get(name))
    changed = f"settings changed: {', '.join(differ)}" if differ else ""
    why = [text for text in ("" if history else "first version", changed) if text]
    otherwise = changed or "its source or the program changed"

    def explain_absence(clip: str, sample: str) -> str:
        if clip in withdrawn:
            return "withdrawn"
        for key in (clip, sample):
            if reason := (refused or {}).get(key):
                return f"refused: {reason}"
        return otherwise if clip in present else "source gone"

    parts = _compare(before, written.index, explain_absence, otherwise)
    why += [f"{part}: {count_text(len(c), 'clip')}" for part, c in parts.items() if c]
    manifest = {
        "spec": load_spec("set_version").label,
        "version": last["version"] + 1,
        **state,
        "counts": count_splits(written.index),
        "why": why or ["shards written anew: the old ones were damaged, or full at another size"],
        **parts,
        **provenance_metadata(),
    }
    write_manifest(out, manifest)
    return manifest


def write_manifest(out: Path, manifest: Manifest) -> None:
    """Write a manifest under its number; OSError if that fails."""
    (out / FOLDER).mkdir(exist_ok=True)
    text = json.dumps(manifest, indent=1, ensure_ascii=False)
    write_atomic(out / FOLDER / f"{manifest['version']:06d}.json", text.encode())


def count_splits(index: pa.Table) -> dict[str, dict[str, int]]:
    """Return the numbers of samples, clips and places of each split."""
    names = ("sample", "clip", "place")
    counts = index.group_by("split").aggregate([(name, "count_distinct") for name in names])
    return {
        row["split"]: {f"{name}s": row[f"{name}_count_distinct"] for name in names}
        for row in counts.sort_by("split").to_pylist()
    }


def _compare(
    before: pa.Table, after: pa.Table, explain_absence: Callable[[str, str], str], otherwise: str
) -> dict[str, dict[str, Any]]:
    """Return the clips that came, went and changed: the number of samples, and why."""
    old, new = ({row["sample"]: row for row in t.to_pylist()} for t in (before, after))
    clips_before = {row["clip"] for row in old.values()}
    parts: dict[str, dict[str, Any]] = {"came": {}, "went": {}, "changed": {}}
    for name in sorted({*old, *new}):
        clip = (new.get(name) or old[name])["clip"]
        if name not in old:
            part, why = "came", otherwise if clip in clips_before else "new clip"
        elif name not in new:
            part, why = "went", explain_absence(clip, name)
        elif changed := [key for key in CONTENT if old[name][key] != new[name][key]]:
            part, why = "changed", f"another {' and '.join(changed)}"
            why += f"; {otherwise}" if "digest" in changed else ""
        else:
            continue
        parts[part].setdefault(clip, {"samples": 0, "why": why})["samples"] += 1
    return {part: dict(sorted(clips.items())) for part, clips in parts.items()}
