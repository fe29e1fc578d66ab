"""A corpus of chunks made ready to learn from: its views and samples, and their lessons.

One chunk goes down one road: the unit of work, of memory, of caching and of failure. Chunks are
known by content, so a second run reads those alone that are new.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from flows.artifact_table import write_artifacts
from flows.corpus_settings import CorpusSettings
from flows.pipeline import check_folder
from flows.runners.progress import Progress
from flows.runners.shard import Failure, Job
from flows.runners.worker_pool import (
    Outcome,
    WorkerPool,
    failures_file,
    job_flow,
    work_through_all,
)
from slgaussian.datasets import re10k
from slgaussian.datasets.pairs import Bounds
from slgaussian.errors import InputError
from slgaussian.io import atomic_path, write_atomic
from slgaussian.parts.method import Method
from slgaussian.storage.provenance import speaking
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.chunks import Framing, known_chunk
from tasks.lessons import lessons
from tasks.pairs import pairs
from tasks.predictions import predictions
from tasks.stage import current
from tasks.views import views

INGEST = ("views", "pairs")
SUPERVISE = (*INGEST, "predictions", "lessons")

FILES = {"views": "views.parquet", "pairs": "pairs.parquet", "lessons": "lessons.parquet"}
"""The tables that the output folder gets, by the stage whose artifacts are joined in it."""


@dataclass(frozen=True)
class Prepared:
    """What a run leaves: how many rows each table has, refs by chunk and stage, and what failed.

    ``outcome`` has all that was made.
    """

    rows: dict[str, int]
    refs: dict[str, dict[str, ArtifactRef]]
    failures: list[Failure]
    outcome: Outcome


def ingest(settings: CorpusSettings, store: ArtifactStore, verbose: bool = False) -> Prepared:
    """Views and samples of all chunks, as ``views.parquet`` and ``pairs.parquet``.

    What could not be used is in ``failures.parquet``: chunks, clips and frames, each with a
    sentence. Needs Prefect to be ready (:func:`flows.runners.environment.orchestration`).

    Raises
    ------
    InputError
        If there is no chunk, or the store or the output folder cannot be written.
    """
    return prepare(settings, store, INGEST, ingest_chunk, (), verbose)


def supervise(settings: CorpusSettings, store: ArtifactStore, verbose: bool = False) -> Prepared:
    """The same, and lessons: ``lessons.parquet`` and a contact sheet a chunk under ``sheets/``.

    Raises
    ------
    InputError
        As :func:`ingest`, and if a part of the method is unknown.
    """
    method = settings.built_by
    method.check()
    framing = Framing(settings.size, settings.near, settings.far)
    return prepare(settings, store, SUPERVISE, supervise_chunk, (framing, method), verbose)


def ingest_chunk(file: str, bounds: Bounds) -> ArtifactRef:
    """The road of a chunk that is ingested: its views, and samples of them."""
    return pairs(views(known_chunk(current().store, file)), bounds)


def supervise_chunk(file: str, bounds: Bounds, framing: Framing, method: Method) -> None:
    """The road of a chunk that is supervised: it goes on to lessons of the samples."""
    chunk = known_chunk(current().store, file)
    samples = pairs(views(chunk), bounds)
    predicted = predictions(samples, chunk, framing, method.predictor, method.seed)
    masked = method.proposer, method.tracker, method.replicas
    lessons(samples, predicted, chunk, framing, *masked)


@job_flow("slgaussian-corpus")
def prepare_chunks(pool: WorkerPool, jobs: Sequence[Job], progress: Progress) -> Outcome:
    """Take all chunks down their road."""
    return work_through_all(jobs, pool, progress)


def prepare(
    settings: CorpusSettings,
    store: ArtifactStore,
    stages: Sequence[str],
    road: Callable[..., object],
    more: tuple[Any, ...],
    verbose: bool = False,
) -> Prepared:
    """Take all chunks down a road, which has these stages, and write their tables.

    The road is called with the place of a chunk, the bounds of its samples, and ``more``.
    """
    chunks = re10k.chunk_names(settings.chunks)
    if not chunks:
        raise InputError(
            f"{settings.chunks}: holds no chunk (.torch); `slgaussian ingest` makes some"
        )
    withdrawn = settings.withdrawn_clips()
    store.check_writable()
    check_folder(settings.out)
    progress = Progress(len(chunks), len(stages), verbose=verbose, unit="chunks")

    folder, bounds = settings.chunks.rstrip("/"), Bounds(**settings.bounds())
    jobs = [
        Job(chunk, road, (f"{folder}/{chunk}", bounds, *more), first="views") for chunk in chunks
    ]
    with progress:
        outcome = prepare_chunks(store, settings.runner, settings.workers, jobs, progress)
    try:
        prepared = _write(settings.out, store, outcome, stages, withdrawn)
    except OSError as error:
        raise InputError(
            f"{settings.out}: cannot write the tables ({error.strerror or error}); what they are "
            "made of is kept in the store, so make room there, or choose another folder with -o, "
            "and run again"
        ) from error
    progress.summary()
    return prepared


def _write(
    out: Path, store: ArtifactStore, outcome: Outcome, stages: Sequence[str], withdrawn: set[str]
) -> Prepared:
    refs = {chunk: outcome.refs[chunk] for chunk in sorted(outcome.refs)}
    failures = [*outcome.failures]
    for own in refs.values():
        for stage in stages:
            failures += [Failure(stage=stage, **bad) for bad in own[stage].meta["left_out"]]
    # A clip belongs to the first chunk that has it; what is withdrawn belongs to none.
    owners = dict.fromkeys(withdrawn, "")
    rows = {}
    for stage in stages:
        if stage in FILES:
            rows[stage] = _join(out / FILES[stage], stage, store, refs, owners, failures)
    if stages == SUPERVISE:
        _write_sheets(out / "sheets", store, refs, withdrawn)
    failures = [failure for failure in failures if failure.scene not in withdrawn]
    failures.sort(key=lambda failure: (failure.scene, failure.reason))
    write_atomic(out / "failures.parquet", failures_file(failures))
    write_artifacts(out, store, [outcome])
    return Prepared(rows, refs, failures, outcome)


def _write_sheets(
    folder: Path,
    store: ArtifactStore,
    refs: Mapping[str, Mapping[str, ArtifactRef]],
    withdrawn: set[str],
) -> None:
    """Write the contact sheet of each chunk, if it shows nothing withdrawn, and remove others."""
    sheets = {}
    for chunk, own in refs.items():
        sheet = own["lessons"].meta.get("sheet")
        # Most chunks are not read for this.
        clips = store.get(own["views"])["clip"].to_pylist() if withdrawn and sheet else ()
        if sheet is not None and withdrawn.isdisjoint(clips):
            sheets[f"{Path(chunk).stem}.png"] = ArtifactRef("sheet", **sheet)
    for file in folder.glob("*.png"):
        if file.name not in sheets:
            file.unlink()
    for name, ref in sheets.items():
        folder.mkdir(exist_ok=True)
        write_atomic(folder / name, store.get(ref)["png"].tobytes())


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
    One that belongs to none is left away.
    """
    count = 0
    schema = speaking(load_spec(stage).schema)
    with atomic_path(file) as name, pq.ParquetWriter(name, schema, compression="zstd") as writer:
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
        if owners.setdefault(clip, chunk) not in (chunk, ""):
            reason = f"clip {clip!r} of {chunk} is in {owners[clip]} too, which is the one used"
            failure = Failure(clip, "views", "InputError", reason)
            if failure not in failures:
                failures.append(failure)
    names = pa.array([chunk] * len(clips), pa.string())
    table = table.set_column(table.column_names.index("chunk"), "chunk", names)
    return table.filter(pa.array([owners[clip] == chunk for clip in clips], pa.bool_()))
