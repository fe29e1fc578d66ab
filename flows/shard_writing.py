"""Writing of samples to the shards of a training set; unchanged shards are reused."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from slgaussian.datasets.leaks import check_shards
from slgaussian.datasets.shards import END_OF_ARCHIVE
from slgaussian.datasets.splits import Split
from slgaussian.datasets.training_set import INDEX, REPAIR
from slgaussian.errors import SpecError
from slgaussian.io import atomic_path, write_atomic
from slgaussian.storage.encoding import decode_table, encode_table
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore

POSITION = ("shard", "offset", "bytes", "digest")
"""Columns of the index with the position of a sample."""


@dataclass(frozen=True)
class Finished:
    """A computed sample: artifact of spec ``example``, place and split."""

    ref: ArtifactRef
    place: str
    split: str

    @property
    def name(self) -> str:
        """Name of the sample."""
        return self.ref.meta["about"]["sample"]


def write_shards(
    out: Path,
    finished: Sequence[Finished],
    store: ArtifactStore,
    shard_bytes: int,
    assigned: Split,
) -> tuple[int, int, int]:
    """Update the shards and the index of a set so that it has exactly these samples.

    An existing shard is reused if it is undamaged and all its samples are still in the set. All
    other samples are written to new shards of each split, sorted by name. The index is written
    after the shards, so that it is valid at any time; then unreferenced shards are removed. Before
    that, the pictures in the shards are checked, and ``assigned`` is written.

    Returns the number of shards of the set, the number of new ones, and the bytes of all.

    Raises:
        DamagedError: If an artifact is damaged.
        InputError: If the split leaks.
        OSError: If a file cannot be written.
    """
    by_name = {item.name: item for item in finished}
    before = _index(out)
    positions: dict[str, dict[str, Any]] = {}
    for shard, rows in before.items():
        if _is_kept(out / shard, rows, by_name):
            positions |= {row["sample"]: {name: row[name] for name in POSITION} for row in rows}
    reused = {position["shard"] for position in positions.values()}
    for split in sorted({item.split for item in finished}):
        numbers = [int(name[len(split) + 1 : -4]) for name in before if name.startswith(split)]
        left = [item for item in finished if item.split == split and item.name not in positions]
        for number, batch in enumerate(_batches(left, shard_bytes), max(numbers, default=-1) + 1):
            positions |= _write(out / f"{split}-{number:06d}.tar", batch, store)
    spec = load_spec("training_set")
    table = []
    for item in finished:
        values = item.ref.meta["about"] | {"place": item.place, "split": item.split}
        values |= positions[item.name]
        table.append({name: values[name] for name in spec.schema.names})
    table.sort(key=lambda row: (row["shard"], row["offset"]))
    index = pa.Table.from_pylist(table, schema=spec.schema)
    check_shards(out, index, {row["shard"] for row in table} - reused)
    assigned.write(out)
    write_atomic(out / INDEX, encode_table(index, spec))
    for shard in before.keys() - reused:
        (out / shard).unlink(missing_ok=True)
    shards = {row["shard"] for row in table}
    size = sum((out / shard).stat().st_size for shard in shards)
    return len(shards), len(shards - reused), size


def _index(out: Path) -> dict[str, list[dict[str, Any]]]:
    """Read the rows of an existing set by shard; none if it is missing or unreadable."""
    try:
        data = (out / INDEX).read_bytes()
        rows = decode_table(data, load_spec("training_set"), str(out / INDEX), REPAIR).to_pylist()
    except (FileNotFoundError, SpecError):
        return {}
    rows_by_shard = defaultdict(list)
    for row in rows:
        rows_by_shard[row["shard"]].append(row)
    return rows_by_shard


def _is_kept(file: Path, rows: Sequence[Mapping[str, Any]], wanted: Mapping[str, Finished]) -> bool:
    """Return whether all samples of a shard stay unchanged, and its file matches the index."""
    if not all(
        row["sample"] in wanted
        and row["split"] == wanted[row["sample"]].split
        and row["digest"] == wanted[row["sample"]].ref.meta["sha256"]
        for row in rows
    ):
        return False
    try:
        with file.open("rb") as shard:
            for row in sorted(rows, key=lambda row: row["offset"]):
                shard.seek(row["offset"])
                if hashlib.sha256(shard.read(row["bytes"])).hexdigest() != row["digest"]:
                    return False
            return shard.read() == END_OF_ARCHIVE
    except OSError:
        return False


def _batches(finished: Sequence[Finished], limit: int) -> Iterator[list[Finished]]:
    batch: list[Finished] = []
    size = 0
    for item in finished:
        batch.append(item)
        size += item.ref.meta["length"]
        if size >= limit:
            yield batch
            batch, size = [], 0
    if batch:
        yield batch


def _write(
    file: Path, batch: Sequence[Finished], store: ArtifactStore
) -> dict[str, dict[str, Any]]:
    """Write a shard, one sample in memory at a time; return the position of each sample."""
    positions = {}
    with atomic_path(file) as name, open(name, "wb") as shard:
        for item in batch:
            values = file.name, shard.tell(), item.ref.meta["length"], item.ref.meta["sha256"]
            positions[item.name] = dict(zip(POSITION, values, strict=True))
            shard.write(store.get(item.ref)["tar"].tobytes())
        shard.write(END_OF_ARCHIVE)
    return positions
