"""Samples in the shards of a training set: tar files in the WebDataset format, and their writing.

The members of one sample are adjacent and share a key: ``KEY.context_0.jpg``, ``KEY.labels.npz``
and so on. The bytes depend only on keys and contents, so a shard is the concatenation of its
samples and :data:`END_OF_ARCHIVE`.

Readers keep an index for days, so a shard is never written again under its name, and one that the
index no longer names stays for a while: ``retired.json`` has the time when it left the index.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import tarfile
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pyarrow as pa

from slgaussian.datasets.splits import SPLITS
from slgaussian.errors import SpecError
from slgaussian.io import atomic_path, write_atomic
from slgaussian.storage.encoding import load_table, save_table
from slgaussian.storage.specs import load_spec

END_OF_ARCHIVE = bytes(2 * tarfile.BLOCKSIZE)  # the end of a tar file
MAX_NAME_LENGTH = 48  # largest number of characters of the clip's name in a key

INDEX = "index.parquet"
REPAIR = "make the set anew with `slgaussian dataset`"

RETIRED = "retired.json"
"""File with the shards that the index no longer names, and when they left it, UTC, ISO 8601."""

SHARD_PATTERN = re.compile(rf"({'|'.join(SPLITS)})-(\d{{6,}})\.tar")


def make_key(clip: str) -> str:
    """Return the key of a clip: letters, digits, ``_`` and ``-``.

    A dot would end the key, and a slash create a folder. A name with other characters, or one that
    is too long, is extended by eight digits of its SHA-256, so that keys are unique.
    """
    plain = re.sub(r"[^A-Za-z0-9_-]", "_", clip)[:MAX_NAME_LENGTH]
    if plain == clip:
        return clip
    return f"{plain}-{hashlib.sha256(clip.encode()).hexdigest()[:8]}"


def pack(key: str, members: Mapping[str, bytes]) -> bytes:
    """Pack one sample as a part of a tar file; members by the suffix of their names."""
    parts = []
    for ending, data in members.items():
        info = tarfile.TarInfo(f"{key}.{ending}")
        info.size = len(data)
        # TarInfo defaults to time 0 and no owner, so the bytes are reproducible.
        parts += [info.tobuf(tarfile.PAX_FORMAT), data, bytes(-len(data) % tarfile.BLOCKSIZE)]
    return b"".join(parts)


def unpack(data: bytes) -> dict[str, bytes]:
    """Invert :func:`pack`; ValueError if ``data`` is not a part of a tar file."""
    members = {}
    try:
        with tarfile.open(fileobj=io.BytesIO(data + END_OF_ARCHIVE), mode="r:") as archive:
            for info in archive:
                file = archive.extractfile(info)
                if file is not None:
                    members[info.name.partition(".")[2]] = file.read()
    except tarfile.TarError as error:
        raise ValueError(str(error)) from None
    return members


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
    with suppress(FileNotFoundError, SpecError):
        return load_table(out / INDEX, "training_set", REPAIR)
    return load_spec("training_set").schema.empty_table()


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
        samples: Rows of the index without ``shard`` and ``offset``.
        read: Returns the bytes of a sample by its name.
        shard_bytes: Size at which a shard is full.
        used: Names of shards of earlier versions, which are not given again.

    Raises:
        DamagedError: As ``read``.
        OSError: If a file cannot be written.
    """
    wanted = {row["sample"]: (row["split"], row["digest"]) for row in samples}
    before = defaultdict(list)
    for row in read_index(out).to_pylist():
        before[row["shard"]].append(row)
    positions: dict[str, tuple[str, int]] = {}
    shards: dict[str, str] = {}
    for shard, rows in before.items():
        stay = all((row["split"], row["digest"]) == wanted.get(row["sample"]) for row in rows)
        if stay and (digest := _digest_intact(out / shard, rows)):
            shards[shard] = digest
            positions |= {row["sample"]: (shard, row["offset"]) for row in rows}
    reused = set(shards)
    names = map(SHARD_PATTERN.fullmatch, {*used, *before, *(file.name for file in out.glob("*"))})
    taken = [(name[1], int(name[2])) for name in names if name]
    for split in sorted({row["split"] for row in samples}):
        number = max((number for taken_split, number in taken if taken_split == split), default=-1)
        left = [r for r in samples if r["split"] == split and r["sample"] not in positions]
        batch: list[Mapping[str, Any]] = []
        for row in left:
            batch.append(row)
            if sum(row["bytes"] for row in batch) >= shard_bytes or row is left[-1]:
                number += 1
                file = out / f"{split}-{number:06d}.tar"
                shards[file.name] = _write(file, batch, read, positions)
                batch = []
    spec, table = load_spec("training_set"), []
    for row in samples:
        row = {**row, **dict(zip(("shard", "offset"), positions[row["sample"]], strict=True))}
        table.append({name: row[name] for name in spec.columns})
    table.sort(key=lambda row: (row["shard"], row["offset"]))
    size = sum((out / shard).stat().st_size for shard in shards)
    index = pa.Table.from_pylist(table, schema=spec.schema)
    return Written(index, dict(sorted(shards.items())), set(shards) - reused, size)


def write_index(out: Path, index: pa.Table) -> None:
    """Write the index of a set, from which moment readers see it; OSError if that fails."""
    save_table(out / INDEX, index, "training_set")


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


def _write(
    file: Path,
    batch: Sequence[Mapping[str, Any]],
    read: Callable[[str], bytes],
    positions: dict[str, tuple[str, int]],
) -> str:
    """Write a shard, one sample in memory at a time, and note positions; return its SHA-256."""
    whole = hashlib.sha256()
    with atomic_path(file) as name, open(name, "wb") as shard:
        for row in batch:
            positions[row["sample"]] = file.name, shard.tell()
            data = read(row["sample"])
            whole.update(data)
            shard.write(data)
        whole.update(END_OF_ARCHIVE)
        shard.write(END_OF_ARCHIVE)
    return whole.hexdigest()
