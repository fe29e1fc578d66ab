"""Removal of withdrawn clips from a store and from folders of results, and the proof of it.

Files are found by what they contain, decoded where it is compressed: the names of the clips and of
their samples, and the digests of their photographs. In a store, all that was computed from such an
artifact goes too, by the lineage in the records. Then everything is searched again.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePath

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from slgaussian.datasets import re10k
from slgaussian.datasets.data_card import describe_set
from slgaussian.datasets.set_versions import FOLDER, add_version, read_versions, write_manifest
from slgaussian.datasets.shards import (
    INDEX,
    make_key,
    read_index,
    retire_shards,
    write_index,
    write_shards,
)
from slgaussian.datasets.training_set import TrainingSet
from slgaussian.errors import InputError
from slgaussian.io import atomic_path, write_atomic
from slgaussian.storage.encoding import decode_npz
from slgaussian.storage.records import FOLDER as RECORDS
from slgaussian.storage.records import Records
from slgaussian.storage.store import ArtifactStore, parse_uri
from slgaussian.storage.tables import read_table

PURGED = "(withdrawn)"
"""Name of purged clips in manifests."""

HISTORY = ".prefect/prefect.db"
"""Prefect's database in a store, with its journals. It names clips; no result depends on it."""

DIGEST = re.compile("[0-9a-f]{64}")


@dataclass(frozen=True)
class Traces:
    """Names of clips and digests of their photographs, by which files of them are found."""

    clips: frozenset[str]
    photographs: frozenset[str]

    @cached_property
    def _words(self) -> re.Pattern[bytes]:
        names = {form for c in self.clips for form in (c, json.dumps(c)[1:-1], make_key(c))}
        words = "|".join(map(re.escape, sorted(names)))
        sample = rf"(?:{words})(?:_\d{{4,}}_\d{{4,}})?"
        text = rf"(?<![\w-])(?:{'|'.join([sample, *sorted(self.photographs)])})(?![\w-])"
        return re.compile(text.encode())

    def is_in_text(self, text: str | bytes) -> bool:
        """Return whether a text has one of them as a whole word."""
        return bool(self._words.search(text if isinstance(text, bytes) else text.encode()))

    def find_in_columns(self, table: pa.Table) -> dict[str, pa.Array]:
        """Return which rows of a table have one of them in a text, bool [N] by column."""
        marked = {}
        for name, column in zip(table.column_names, table.columns, strict=True):
            if pa.types.is_string(column.type):
                texts = [t for t in column.unique().to_pylist() if t and self.is_in_text(t)]
                if texts:
                    marked[name] = pc.is_in(column, pa.array(texts, pa.string()))
        return marked

    def cut_from(self, table: pa.Table) -> pa.Table:
        """Return a table without rows of the clips, and without their names in other rows.

        A place that is named after a clip keeps its name, on which its side of a split depends.
        """
        for name, marked in self.find_in_columns(table).items():
            number = table.column_names.index(name)
            if name != "place" and table.schema.field(number).nullable:
                empty = pc.if_else(marked, None, table[name])
                table = table.set_column(number, table.schema.field(number), empty)
        marks = [marked for name, marked in self.find_in_columns(table).items() if name != "place"]
        keep = np.ones(table.num_rows, bool)
        for marked in marks:
            keep &= ~marked.to_numpy()
        return table.filter(pa.array(keep))

    def is_in_clip(self, clip: re10k.Clip) -> bool:
        """Return whether it is one of the clips, or has one of their photographs."""
        digests = (hashlib.sha256(image).hexdigest() for image in clip.images)
        return clip.key in self.clips or not self.photographs.isdisjoint(digests)

    def is_in_file(self, name: str, data: bytes) -> bool:
        """Return whether a file has one of them, also compressed, or is a photograph."""
        if self.is_in_text(data) or hashlib.sha256(data).hexdigest() in self.photographs:
            return True
        suffix = PurePath(name).suffix
        with suppress(Exception):  # damaged: its bytes were searched
            if suffix == ".parquet":
                return bool(self.find_in_columns(read_table(data)))
            if suffix == ".torch":
                return any(map(self.is_in_clip, re10k.clips_in(data, name)))
            if suffix == ".npz":
                arrays, metadata = decode_npz(data)
                texts = [json.dumps(metadata)]
                texts += [str(t) for a in arrays.values() if a.dtype.kind == "U" for t in a.flat]
                files = [(n, a) for n, a in arrays.items() if a.dtype == "u1" and a.ndim == 1]
                return self.is_in_text("\n".join(texts)) or any(
                    self.is_in_file(f"x.{suffix}", array.tobytes()) for suffix, array in files
                )
        return False


def find_clips(place: str | None, sets: Sequence[Path]) -> set[str]:
    """Return the clips of a place by the indexes of training sets; none for no place."""
    rows = [row for folder in sets for row in read_index(folder).to_pylist()]
    return {row["clip"] for row in rows if row["place"] == place}


def find_traces(clips: Collection[str], store: ArtifactStore, folders: Sequence[Path]) -> Traces:
    """Find the photographs of clips in tables of views, and the clips that have the same ones."""
    views = set[tuple[str, str]]()
    tables = [
        store.read(f.uri) for files in store.walk(["views"]) for f in files if parse_uri(f.uri)
    ]
    tables += [file.read_bytes() for folder in folders for file in folder.rglob("views.parquet")]
    for data in tables:
        with suppress(ValueError, OSError, pa.ArrowException):  # damaged
            table = read_table(data, ["clip", "digest"])
            views.update(
                zip(*(table[name].to_pylist() for name in table.column_names), strict=True)
            )
    names, photographs, before = set(clips), set[str](), 0
    while before != len(names):
        before = len(names)
        photographs = {digest for clip, digest in views if clip in names}
        names |= {clip for clip, digest in views if digest in photographs}
    return Traces(frozenset(names), frozenset(photographs))


def remove_traces(traces: Traces, store: ArtifactStore, folders: Sequence[Path]) -> None:
    """Remove clips from a store, with what was computed from them, and from folders of results.

    Raises:
        InputError: As :func:`purge_folder`.
    """
    store.remove(find_derived_files(store, search_store(store, traces)[1]))
    for folder in folders:
        purge_folder(folder, traces)


def search_all(
    traces: Traces, store: ArtifactStore, folders: Sequence[Path]
) -> list[tuple[str, int, list[str]]]:
    """Return for a store and each folder the number of files, and those that clips led to."""
    count, left = search_store(store, traces)
    result = [(store.root, count, sorted({*left, *find_derived_files(store, left)}))]
    for folder in folders:
        count, traced = search_folder(folder, traces)
        result.append((str(folder), count, [str(file) for file in traced]))
    return result


def search_store(store: ArtifactStore, traces: Traces) -> tuple[int, set[str]]:
    """Search all files of a store; return their number, and the paths of those with traces."""
    uris = [file.uri for files in store.walk() for file in files]
    return len(uris), {uri for uri in uris if traces.is_in_file(uri, store.read(uri))}


def search_folder(folder: Path, traces: Traces) -> tuple[int, list[Path]]:
    """Search all files of a folder; return their number, and those with traces."""
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    return len(files), [file for file in files if traces.is_in_file(file.name, file.read_bytes())]


def find_derived_files(store: ArtifactStore, marked: Collection[str]) -> list[str]:
    """Return the files of a store to remove: ``marked`` ones, and what was computed from them.

    Those that lead to others come last, so that a removal that was interrupted can be repeated.
    Artifacts that other records refer to stay, as do files that are not of the store.
    """
    records = [record for page in Records(store).all() for record in page if record.ref]
    digests = {ref.digest for uri in marked if (ref := parse_uri(uri))}
    gone, before = dict[str, None](), -1
    while before != len(digests) + len(gone):
        before = len(digests) + len(gone)
        for record in records:
            assert record.ref is not None
            used = {record.ref.digest, *DIGEST.findall(json.dumps(record.ref.meta))}
            if record.file.uri in marked or not digests.isdisjoint(used):
                gone[record.file.uri] = None
                digests.add(record.ref.digest)
    shared = {uri for r in records if r.file.uri not in gone for uri in r.uris}
    lost = {uri for r in records if r.file.uri in gone for uri in r.uris}
    direct = {
        uri for uri in marked if parse_uri(uri) or uri.startswith((f"{RECORDS}/", "digests/"))
    }
    if any(uri.startswith(HISTORY) for uri in marked):
        direct |= {f"{HISTORY}{ending}" for ending in ("", "-wal", "-shm")}
    return [
        *sorted(lost - shared - direct),
        *(uri for uri in reversed(gone) if uri not in direct),
        *sorted(direct),
    ]


def purge_folder(folder: Path, traces: Traces) -> None:
    """Remove clips from a training set, or from the tables and chunks of a corpus.

    Rows and clips go, and shards are written again without their samples, as a new version.

    Raises:
        InputError: If nothing would be left of a set, or the folder cannot be written.
        SpecError: If a file is damaged.
    """
    index, is_set = folder / INDEX, read_index(folder).num_rows > 0
    try:
        for file in search_folder(folder, traces)[1]:
            if file.parent.name == FOLDER or (is_set and file == index):
                continue  # manifests and the index follow; records of weights never change
            if file.suffix == ".parquet":
                table = traces.cut_from(read_table(file))
                with atomic_path(file) as draft:
                    pq.write_table(table, draft, compression="zstd")
            elif file.suffix == ".torch":
                clips = [clip for clip in re10k.read_chunk(file) if not traces.is_in_clip(clip)]
                if clips:
                    write_atomic(file, re10k.encode_chunk(clips))
                else:
                    file.unlink()
            elif file.name == re10k.INDEX:
                chunks = re10k.read_index(file.parent)
                chunks = {clip: chunk for clip, chunk in chunks.items() if clip not in traces.clips}
                write_atomic(file, json.dumps(chunks, indent=1).encode())
        if is_set:
            _purge_set(folder, traces)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror or error})") from error


def _purge_set(out: Path, traces: Traces) -> None:
    """Write a version of a set without the clips; remove the shards that have them."""
    before, history = read_index(out), read_versions(out)
    rows = [row for row in before.to_pylist() if row["clip"] not in traces.clips]
    if not rows:
        raise InputError(f"{out}: all of its samples are withdrawn; delete the folder")
    samples = TrainingSet(out)
    numbers = {name: n for n, name in enumerate(before["sample"].to_pylist())}
    if not history:
        raise InputError(f"{out}: has no manifest in versions/; run `slgaussian dataset` again")
    settings = history[-1]["settings"]
    used = {name for manifest in history for name in manifest["shards"]}
    written = write_shards(
        out, rows, lambda name: samples.data(numbers[name]), settings["shard_mb"] * 1e6, used
    )
    add_version(out, before, written, settings, traces.clips)
    for manifest in read_versions(out):
        for part in ("came", "went", "changed"):
            marked = [c for c, entry in manifest[part].items() if traces.is_in_text(f"{c} {entry}")]
            count = sum(manifest[part].pop(clip)["samples"] for clip in marked)
            if marked:
                manifest[part][PURGED] = {"samples": count, "why": "withdrawn"}
        licences = manifest["settings"]["licences"]
        for source in [name for name in licences if traces.is_in_text(name)]:
            del licences[source]
        write_manifest(out, manifest)
    write_index(out, written.index)
    for shard in out.glob("*.tar"):
        if shard.name not in written.shards and traces.is_in_file(shard.name, shard.read_bytes()):
            shard.unlink()
    retire_shards(out, written.shards, settings["keep_old_days"])
    describe_set(out, manifest)
