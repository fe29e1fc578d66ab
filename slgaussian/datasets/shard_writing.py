"""Writing of samples to the shards of a training set; unchanged shards are reused.

Readers keep an index for days, so a shard is never written again under its name, and one that the
index no longer names stays for a while: ``retired.json`` has the time when it left the index.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pyarrow as pa

from slgaussian.datasets.shards import END_OF_ARCHIVE
from slgaussian.datasets.training_set import INDEX, REPAIR, SPLITS
from slgaussian.errors import SpecError
from slgaussian.io import atomic_path, write_atomic
from slgaussian.storage.encoding import decode_table, encode_table
from slgaussian.storage.specs import load_spec

POSITION = ("shard", "offset")
"""Columns of the index with the position of a sample."""

RETIRED = "retired.json"
"""File with the shards that the index no longer names, and when they left it, UTC, ISO 8601."""

SHARD_PATTERN = re.compile(rf"({'|'.join(SPLITS)})-(\d{{6,}})\.tar")


@dataclass(frozen=True, eq=False)
class Written:
    """Result of :func:`write_shards`.

    Attributes:
        index: Rows of spec ``training_set``, to be written by :func:`write_index`.
        shards: SHA-256 of every shard that the index names, hexadecimal, by name.
        new: Names of those that were written.
        bytes: Total size of the shards.
    """

    index: pa.Table
    shards: dict[str, str]
    new: set[str]
    bytes: int


def read_index(out: Path) -> pa.Table:
    """Read the index of a set, spec ``training_set``; empty if it is missing or unreadable."""
    spec = load_spec("training_set")
    try:
        return decode_table((out / INDEX).read_bytes(), spec, str(out / INDEX), REPAIR)
    except (FileNotFoundError, SpecError):
        return spec.schema.empty_table()


def write_shards(
    out: Path,
    samples: Sequence[Mapping[str, Any]],
    read: Callable[[str], bytes],
    shard_bytes: float,
    used: Collection[str] = (),
) -> Written:
    """Write the shards of a set, so that together with existing ones they have these samples.

    An existing shard is reused if it is undamaged and all its samples are still in the set. All
    other samples are written to new shards of each split, in the given order. The index is not
    written yet, so that readers see the set as it was.

    Args:
        samples: Rows of the index without :data:`POSITION`.
        read: Returns the bytes of a sample by its name.
        shard_bytes: Size at which a shard is full.
        used: Names of shards of earlier versions, which are not given again.

    Raises:
        DamagedError: As ``read``.
        OSError: If a file cannot be written.
    """
    wanted = {row["sample"]: row for row in samples}
    before = defaultdict(list)
    for row in read_index(out).to_pylist():
        before[row["shard"]].append(row)
    positions: dict[str, dict[str, Any]] = {}
    shards: dict[str, str] = {}
    for shard, rows in before.items():
        stay = all(_is_same(row, wanted.get(row["sample"])) for row in rows)
        if stay and (digest := _digest_intact(out / shard, rows)):
            shards[shard] = digest
            positions |= {row["sample"]: {name: row[name] for name in POSITION} for row in rows}
    reused, size = set(shards), 0
    names = map(SHARD_PATTERN.fullmatch, {*used, *before, *(file.name for file in out.glob("*"))})
    taken = [(name[1], int(name[2])) for name in names if name]
    for split in sorted({row["split"] for row in samples}):
        first = max((number for of, number in taken if of == split), default=-1) + 1
        left = [r for r in samples if r["split"] == split and r["sample"] not in positions]
        for number, batch in enumerate(_batches(left, shard_bytes), first):
            file = out / f"{split}-{number:06d}.tar"
            shards[file.name] = _write(file, batch, read, positions)
    spec = load_spec("training_set")
    table = [{name: {**row, **positions[row["sample"]]}[name] for name in spec.columns}
             for row in samples]  # fmt: skip
    table.sort(key=lambda row: (row["shard"], row["offset"]))
    size = sum((out / shard).stat().st_size for shard in shards)
    index = pa.Table.from_pylist(table, schema=spec.schema)
    return Written(index, dict(sorted(shards.items())), set(shards) - reused, size)


def write_index(out: Path, index: pa.Table) -> None:
    """Write the index of a set, from which moment readers see it; OSError if that fails."""
    write_atomic(out / INDEX, encode_table(index, load_spec("training_set")))


def retire_shards(out: Path, shards: Collection[str], keep_days: float) -> None:
    """List shards besides ``shards`` as retired, and remove those retired for ``keep_days``."""
    since: dict[str, str] = {}
    with suppress(OSError, ValueError):
        since = json.loads((out / RETIRED).read_bytes())
    now = datetime.now(UTC)
    others = [f.name for f in out.glob("*.tar") if SHARD_PATTERN.fullmatch(f.name)]
    retired = {}
    for name in sorted(set(others) - set(shards)):
        time = since.get(name, now.isoformat(timespec="seconds"))
        if datetime.fromisoformat(time) <= now - timedelta(days=keep_days):
            (out / name).unlink()
        else:
            retired[name] = time
    if retired:
        write_atomic(out / RETIRED, json.dumps(retired, indent=1).encode())
    else:
        (out / RETIRED).unlink(missing_ok=True)


def _is_same(row: Mapping[str, Any], wanted: Mapping[str, Any] | None) -> bool:
    return wanted is not None and all(row[name] == wanted[name] for name in ("split", "digest"))


def _digest_intact(file: Path, rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the SHA-256 of a shard; empty if it does not match the rows of the index."""
    whole = hashlib.sha256()
    try:
        with file.open("rb") as shard:
            for row in sorted(rows, key=lambda row: row["offset"]):
                data = shard.read(row["bytes"])
                whole.update(data)
                is_at_place = shard.tell() == row["offset"] + row["bytes"]
                if not is_at_place or hashlib.sha256(data).hexdigest() != row["digest"]:
                    return ""
            whole.update(END_OF_ARCHIVE)
            return whole.hexdigest() if shard.read() == END_OF_ARCHIVE else ""
    except OSError:
        return ""


def _batches(
    samples: Sequence[Mapping[str, Any]], limit: float
) -> Iterator[list[Mapping[str, Any]]]:
    batch: list[Mapping[str, Any]] = []
    size = 0
    for row in samples:
        batch.append(row)
        size += row["bytes"]
        if size >= limit:
            yield batch
            batch, size = [], 0
    if batch:
        yield batch


def _write(
    file: Path,
    batch: Sequence[Mapping[str, Any]],
    read: Callable[[str], bytes],
    positions: dict[str, dict[str, Any]],
) -> str:
    """Write a shard, one sample in memory at a time, and note positions; return its SHA-256."""
    whole = hashlib.sha256()
    with atomic_path(file) as name, open(name, "wb") as shard:
        for row in batch:
            positions[row["sample"]] = dict(zip(POSITION, (file.name, shard.tell()), strict=True))
            data = read(row["sample"])
            whole.update(data)
            shard.write(data)
        whole.update(END_OF_ARCHIVE)
        shard.write(END_OF_ARCHIVE)
    return whole.hexdigest()
