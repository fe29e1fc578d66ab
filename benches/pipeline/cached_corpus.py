"""A corpus of 100,000 clips that is known already.

    python -m benches.pipeline.cached_corpus WORK [-o FILE]

The clips are those of one made-up room, small, in chunks of 14, as many as a published chunk of
RealEstate10K has; each has its own key and so its own samples, lessons and records. What a run
would make of them is put into the store without the hours of making it: it is what one chunk gave,
with other names, and some chunks are made for real to compare. Measured is what an
operator waits for: listing the chunks, computing all keys, and the commands on a corpus of which
all is done, each in a process of its own.
"""

from __future__ import annotations

import argparse
import hashlib
import shutil
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from benches.common.pages import publish
from benches.common.process_cost import CLI, costing
from benches.pipeline.chunk_stages import chunk_stages, settings_of
from flows.config import CorpusSettings
from flows.corpus import SUPERVISE
from flows.read_config import make_settings
from slgaussian import datasets
from slgaussian.datasets import re10k
from slgaussian.datasets.pair_selection import Bounds
from slgaussian.io import SETTLED
from slgaussian.storage.records import Records
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.chunks import Framing, known_chunk
from tasks.stage import Stage

CLIPS = 14
"""Of a chunk: 67,000 clips of RealEstate10K are 500 GB in chunks of 100 MB."""
VIEWS, HEIGHT, WIDTH = 6, 180, 320
SETTINGS = {"size": "16x16", "near": 1.0, "far": 8.0, "replicas": 1}
COMMANDS = (("ingest", "threads", 1), ("supervise", "threads", 1), ("supervise", "processes", 2))
CHECKED = 5
"""Chunks that are made for real as well."""


def key_of(number: int) -> str:
    """A key as RealEstate10K's clips have."""
    return hashlib.sha256(str(number).encode()).hexdigest()[:16]


def clips_of(chunk: int, room: re10k.Clip) -> list[re10k.Clip]:
    return [replace(room, key=key_of(chunk * CLIPS + i)) for i in range(CLIPS)]


def write_chunks(folder: Path, chunks: int, room: re10k.Clip) -> None:
    """All chunks of the catalogue. No index: nothing that prepares a corpus reads it."""
    folder.mkdir(parents=True)
    for chunk in range(chunks):
        re10k.write(folder / "new", clips_of(chunk, room))
        (folder / "new" / "000000.torch").rename(folder / name_of(chunk))
        (folder / "new" / re10k.INDEX).unlink()
    (folder / "new").rmdir()


def renamed(table: pa.Table, names: dict[str, str]) -> list[dict]:
    """The rows of a table with the clips of another chunk."""
    rows = table.to_pylist()
    for row in rows:
        old = row.get("clip") or row["sample"][:16]
        row |= {"clip": names[old]} if "clip" in row else {}
        row |= {"sample": names[old] + row["sample"][16:]} if "sample" in row else {}
    return rows


class Filler:
    """Puts what a run would make of a chunk into the store."""

    def __init__(self, store: ArtifactStore, folder: Path) -> None:
        self.store, self.settings = store, corpus_settings(folder)
        self.refs = self.kept(0, store)
        self.tables = {stage: store.get(ref) for stage, ref in self.refs.items()}
        self.lessons = {
            row["sample"]: store.get(ArtifactRef("lesson", row["uri"], row["digest"]))
            for row in self.tables["lessons"].to_pylist()
        }

    def kept(self, chunk: int, store: ArtifactStore) -> dict[str, ArtifactRef]:
        """What a run made of a chunk, by the records."""
        refs: dict[str, ArtifactRef] = {}
        for stage, arguments in stages_of(self.settings, name_of(chunk), store, refs):
            refs[stage.name] = Records(store).find(stage.key(arguments))
        return refs

    def fill(self, chunk: int) -> dict[str, ArtifactRef]:
        """What a run would make of it, were nothing seeded by the names of samples."""
        names = {key_of(i): key_of(chunk * CLIPS + i) for i in range(CLIPS)}
        refs: dict[str, ArtifactRef] = {}
        for made, arguments in stages_of(self.settings, name_of(chunk), self.store, refs):
            stage = made.name
            rows = renamed(self.tables[stage], names)
            meta = {**self.refs[stage].meta, "settings": settings_of(made, arguments)}
            if stage == "lessons":
                for old, row in zip(self.lessons, rows, strict=True):
                    arrays = {**self.lessons[old], "sample": np.array(row["sample"])}
                    ref = self.store.put("lesson", arrays)
                    row |= {"uri": ref.uri, "digest": ref.digest}
                meta["parts"] = [row["uri"] for row in rows] + meta["parts"][len(rows) :]
            table = pa.Table.from_pylist(rows, schema=load_spec(stage).schema)
            refs[stage] = self.store.put(stage, table, meta)
            Records(self.store).keep(made.key(arguments), refs[stage])
        return refs


def name_of(chunk: int) -> str:
    return f"{chunk:06d}.torch"


def corpus_settings(folder: Path) -> CorpusSettings:
    given = {**SETTINGS, "chunks": str(folder), "out": folder.parent / "corpus"}
    return make_settings(given, "bench", CorpusSettings)


def stages_of(
    settings: CorpusSettings, chunk: str, store: ArtifactStore, refs: dict[str, ArtifactRef]
) -> Iterator[tuple[Stage, dict[str, Any]]]:
    """The stages of a chunk, each with its arguments."""
    known = known_chunk(store, f"{settings.chunks}/{chunk}")
    framing = Framing(settings.size, settings.near, settings.far)
    return chunk_stages(known, Bounds(**settings.bounds()), framing, settings.built_by, refs)


def made(chunks: Path, store: Path) -> None:
    """Really make the lessons of a folder of chunks."""
    words = ["supervise", chunks, "-o", store.parent / "out", "--store", store]
    costing([*CLI, *words, *options()])


def options() -> list[str]:
    return [word for key, value in SETTINGS.items() for word in ("--set", f"{key}={value}")]


def prepare(work: Path, chunks: int) -> None:
    """Chunks and store, unless they are there."""
    if (work / "ready").exists():
        return
    folder, start = work / "chunks", time.perf_counter()
    scene = datasets.load(
        "procedural", seed=1, views=VIEWS, baseline=0.8, height=HEIGHT, width=WIDTH
    )
    room = re10k.clip_of(scene)
    write_chunks(work / "first", 1, room)
    made(work / "first", work / "store")
    write_chunks(folder, chunks, room)
    time.sleep(SETTLED)
    print(f"{chunks} chunks in {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    filler = Filler(ArtifactStore(work / "store"), folder)
    for chunk in range(1, chunks):
        refs = filler.fill(chunk)
        if chunk % (chunks // CHECKED + 1) == 1:
            check(filler, chunk, refs, work / f"check-{chunk}")
    print(f"filled in {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    (work / "ready").touch()


def check(filler: Filler, chunk: int, refs: dict[str, ArtifactRef], work: Path) -> None:
    """That a run from nothing makes the same views and samples of a chunk, and as many lessons."""
    (work / "chunks").mkdir(parents=True)
    shutil.copy(Path(filler.settings.chunks) / name_of(chunk), work / "chunks")
    made(work / "chunks", work / "store")
    for stage, ref in filler.kept(chunk, ArtifactStore(work / "store")).items():
        same = ref.digest == refs[stage].digest
        if not (same or stage in ("predictions", "lessons")) or rows(ref) != rows(refs[stage]):
            raise SystemExit(f"chunk {chunk}, {stage}: not what a run makes")


def rows(ref: ArtifactRef) -> tuple:
    return tuple(ref.meta.get(name) for name in ("clips", "views", "samples"))


def listing(work: Path) -> list[dict]:
    """Seconds to list all chunks, and to compute the keys of all their stages."""
    folder, store = work / "chunks", ArtifactStore(work / "store")
    start = time.perf_counter()
    chunks = re10k.chunk_names(folder)
    rows = [{"what": f"list {len(chunks)} chunks", "wall": time.perf_counter() - start}]
    settings, refs, keys = corpus_settings(folder), Filler(store, folder).refs, 0
    start = time.perf_counter()
    for chunk in chunks:
        # Digests of content are all of a ref that keys depend on; which one is the same to time.
        keys += sum(bool(s.key(given)) for s, given in stages_of(settings, chunk, store, refs))
    return [*rows, {"what": f"compute {keys} keys", "wall": time.perf_counter() - start}]


def command(work: Path, name: str, runner: str, workers: int) -> dict:
    """What a command costs of which all is done."""
    words = [name, work / "chunks", "-o", work / "out", "--store", work / "store"]
    words += ["--runner", runner, "--workers", workers]
    if name == "supervise":
        words += options()
    cost = costing([*CLI, *words])
    made = [line for line in cost.output if " in " in line and line.split()[0] in SUPERVISE]
    if made:
        raise SystemExit(f"not all of it was done: {made}")
    shown = f"`{name} --runner {runner} --workers {workers}`"
    return {"what": shown, "wall": cost.wall, "cpu": cost.cpu, "peak": cost.peak}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path, help="folder for chunks and store, kept")
    parser.add_argument("--clips", type=int, default=100_000)
    parser.add_argument("-o", "--out", type=Path, help="file for the table")
    asked = parser.parse_args()
    chunks = -(-asked.clips // CLIPS)
    work = asked.work.resolve()
    prepare(work, chunks)
    rows = listing(work)
    for name, runner, workers in COMMANDS:
        rows.append(command(work, name, runner, workers))
        print(rows[-1], file=sys.stderr, flush=True)
    size = sum(file.stat().st_size for file in (work / "chunks").iterdir()) / 1e9
    counts = {"clips": chunks * CLIPS, "chunks": chunks, "size": size}
    publish("pipeline/cached_corpus.md.j2", asked.out, rows=rows, **counts)


if __name__ == "__main__":
    main()
