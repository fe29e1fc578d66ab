"""A corpus of chunks made ready to learn from: its views and samples, and their lessons.

One chunk is one chain of stages: the unit of work, of memory, of caching and of failure. Chunks are
known by content, so a second run reads those alone that are new.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from flows.corpus_settings import CorpusSettings
from flows.pipeline import check_folder
from flows.runners.progress import Progress
from flows.runners.worker_pool import Crew, Outcome, failures_table, run_chains, run_flow
from slgaussian.build import check_parts
from slgaussian.datasets import re10k
from slgaussian.errors import InputError
from slgaussian.parts.identity import described, places
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import (
    ArtifactRef,
    ArtifactStore,
    encode_table,
    replacing,
    write_atomic,
)
from tasks.chunks import digest_of
from tasks.shard import Chain, Failure, Step

INGEST = ("views", "pairs")
SUPERVISE = (*INGEST, "predictions", "lessons")

FILES = {"views": "views.parquet", "pairs": "samples.parquet", "lessons": "lessons.parquet"}
"""The tables that the output folder gets, by the stage whose artifacts are joined in it."""


@dataclass(frozen=True)
class Prepared:
    """What a run leaves: how many rows each table has, refs by chunk and stage, and what failed."""

    rows: dict[str, int]
    refs: dict[str, dict[str, ArtifactRef]]
    failures: list[Failure]


def ingest(settings: CorpusSettings, store: ArtifactStore, verbose: bool = False) -> Prepared:
    """Views and samples of all chunks, as ``views.parquet`` and ``samples.parquet``.

    What could not be used is in ``failures.parquet``: chunks, clips and frames, each with a
    sentence. Needs Prefect to be ready (:func:`flows.runners.environment.orchestration`).

    Raises
    ------
    InputError
        If there is no chunk, or the store or the output folder cannot be written.
    """
    return prepare(settings, store, INGEST, verbose)


def supervise(settings: CorpusSettings, store: ArtifactStore, verbose: bool = False) -> Prepared:
    """The same, and lessons: ``lessons.parquet`` and a contact sheet a chunk under ``sheets/``.

    Raises
    ------
    InputError
        As :func:`ingest`, and if a part of the method is unknown.
    """
    check_parts(**settings.part_names(), settings=settings.part_settings())
    return prepare(settings, store, SUPERVISE, verbose)


def steps(
    settings: CorpusSettings, chunk: str, stages: Sequence[str], store: ArtifactStore
) -> list[Step]:
    """The steps of one chunk, each with just the settings that its result depends on."""
    file = f"{settings.chunks.rstrip('/')}/{chunk}"
    content, where = {"chunk": digest_of(store, file)}, {"chunk": file}
    own = settings.part_settings()
    of_parts = {**settings.model_dump(include={"predictor", "proposer", "tracker", "replicas"})}
    of_parts |= described({part: own[part] for part in of_parts.values() if part in own})

    def parts(*names: str) -> dict:
        tables = [of_parts[name] for name in names if of_parts[name] in of_parts]
        return {name: of_parts[name] for name in (*names, *tables)}

    views = {"size": settings.size, "near": settings.near, "far": settings.far}
    masks = {
        part: place
        for part in (settings.proposer, settings.tracker)
        for place in places(own.get(part, {})).values()
    }
    made = [
        Step("views", content, where=where),
        Step("pairs", {"bounds": settings.bounds()}, {"views": "views"}),
        Step(
            "predictions",
            {**content, **views, **parts("predictor"), "seed": settings.seed},
            {"pairs": "pairs"},
            {**places(own.get(settings.predictor, {})), **where},
        ),
        Step(
            "lessons",
            {**content, **views, **parts("proposer", "tracker", "replicas")},
            {"pairs": "pairs", "predictions": "predictions"},
            {**masks, **where},
        ),
    ]
    return [step for step in made if step.stage in stages]


def prepare(
    settings: CorpusSettings, store: ArtifactStore, stages: Sequence[str], verbose: bool = False
) -> Prepared:
    """Run ``stages``, the first few of :data:`SUPERVISE`, on all chunks and write their tables."""
    chunks = re10k.chunk_names(settings.chunks)
    if not chunks:
        raise InputError(
            f"{settings.chunks}: holds no chunk (.torch); `slgaussian pack` makes some"
        )
    store.check_writable()
    check_folder(settings.out)
    progress = Progress(len(chunks), len(stages), verbose=verbose, unit="chunks")

    def work(crew: Crew) -> Outcome:
        chains = [
            Chain(chunk, partial(steps, settings, chunk, stages), first="views") for chunk in chunks
        ]
        return run_chains(chains, crew, progress)

    with progress:
        outcome = run_flow("slgaussian-corpus", work, store, settings.runner, settings.workers)
    try:
        prepared = _write(settings.out, store, outcome, stages)
    except OSError as error:
        raise InputError(
            f"{settings.out}: cannot write the tables ({error.strerror or error}); what they are "
            "made of is kept in the store, so make room there, or choose another folder with -o, "
            "and run again"
        ) from error
    progress.summary()
    return prepared


def _write(out: Path, store: ArtifactStore, outcome: Outcome, stages: Sequence[str]) -> Prepared:
    refs = {chunk: outcome.refs[chunk] for chunk in sorted(outcome.refs)}
    failures = [*outcome.failures]
    for own in refs.values():
        for stage in stages:
            failures += [Failure(stage=stage, **bad) for bad in own[stage].meta["left_out"]]
    owners: dict[str, str] = {}
    rows = {}
    for stage in stages:
        if stage in FILES:
            rows[stage] = _join(out / FILES[stage], stage, store, refs, owners, failures)
    sheets = out / "sheets"
    for chunk, own in refs.items():
        sheet = own[stages[-1]].meta.get("sheet")
        if sheet is not None:
            sheets.mkdir(exist_ok=True)
            png = store.get(ArtifactRef("sheet", **sheet))["png"]
            write_atomic(sheets / f"{Path(chunk).stem}.png", png.tobytes())
    failures.sort(key=lambda failure: (failure.scene, failure.reason))
    write_atomic(out / "failures.parquet", encode_table(failures_table(failures)))
    return Prepared(rows, refs, failures)


def _join(
    file: Path,
    stage: str,
    store: ArtifactStore,
    refs: Mapping[str, Mapping[str, ArtifactRef]],
    owners: dict[str, str],
    failures: list[Failure],
) -> int:
    """Write one table of those of all chunks, one of them in memory at a time; its rows.

    A clip belongs to the first chunk that has it, ``owners``; another with its key is a failure.
    """
    count = 0
    schema = load_spec(stage).schema
    with replacing(file) as name, pq.ParquetWriter(name, schema, compression="zstd") as writer:
        for chunk, own in refs.items():
            table = _own_rows(store.get(own[stage]), chunk, owners, failures)
            count += table.num_rows
            writer.write_table(table)
    return count


def _own_rows(
    table: pa.Table, chunk: str, owners: dict[str, str], failures: list[Failure]
) -> pa.Table:
    clips = table["clip"].to_pylist()
    for clip in dict.fromkeys(clips):
        if owners.setdefault(clip, chunk) != chunk:
            reason = f"clip {clip!r} of {chunk} is in {owners[clip]} too, which is the one used"
            failure = Failure(clip, "views", "InputError", reason)
            if failure not in failures:
                failures.append(failure)
    names = pa.array([chunk] * len(clips), pa.string())
    table = table.set_column(table.column_names.index("chunk"), "chunk", names)
    return table.filter(pa.array([owners[clip] == chunk for clip in clips], pa.bool_()))
