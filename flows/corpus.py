"""Preparation of a corpus of chunks for training: views, samples and lessons.

A chunk is the unit of work, of memory, of caching and of failure. Chunks are identified by their
content, so a second run reads only new chunks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from prefect import flow
from prefect.states import State

from flows.config import CorpusSettings
from flows.runners.batches import Failure, Outcome, SceneTask, map_shown, write_failures
from flows.runners.session import check_folder, completed, run_session, stages_to_refresh, writing
from flows.runners.task_runners import open_workers
from slgaussian.components.method import Method
from slgaussian.datasets import re10k
from slgaussian.datasets.configs import Bounds
from slgaussian.errors import InputError
from slgaussian.io import atomic_path
from slgaussian.storage.provenance import with_provenance
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.chunks import Framing, known_chunk, pairs, views
from tasks.context import current_run
from tasks.predictions import predictions
from tasks.samples import lessons

INGEST = ("views", "pairs")
SUPERVISE = (*INGEST, "predictions", "lessons")

FILES = {"views": "views.parquet", "pairs": "pairs.parquet", "lessons": "lessons.parquet"}
"""Tables in the output folder, by the stage whose artifacts are concatenated."""


@dataclass(frozen=True)
class Prepared:
    """Result of a run: number of rows of each table, and failures."""

    rows: dict[str, int]
    failures: list[Failure]

    @property
    def message(self) -> str:
        """The rows of each table, as text."""
        return ", ".join(f"{count} {stage}" for stage, count in self.rows.items())


@flow(name="slgaussian-ingest", persist_result=False)
def ingest_corpus(config: CorpusSettings, verbose: bool = False) -> State[Prepared]:
    """Choose samples of all chunks: ``views.parquet`` and ``pairs.parquet``.

    Chunks, clips and frames that could not be used are in ``failures.parquet`` with the reasons.

    Raises:
        InputError: If there is no chunk, or the store or the output folder cannot be written.
    """
    prepared = run_session(
        "ingest", config,
        lambda store: _prepare(config, store, INGEST, ingest_chunk, (), verbose),
    )  # fmt: skip
    return completed(prepared.message, prepared, prepared.failures)


@flow(name="slgaussian-supervise", persist_result=False)
def supervise_corpus(config: CorpusSettings, verbose: bool = False) -> State[Prepared]:
    """Make the lessons of a corpus: ``lessons.parquet``, and the tables of :func:`ingest_corpus`.

    Raises:
        InputError: As :func:`ingest_corpus`, and if a component of the method is unknown.
    """
    prepared = run_session("supervise", config, lambda store: supervise(config, store, verbose))
    return completed(prepared.message, prepared, prepared.failures)


def supervise(config: CorpusSettings, store: ArtifactStore, verbose: bool = False) -> Prepared:
    """Do the work of :func:`supervise_corpus` within any flow."""
    method = config.built_by
    method.check()
    framing = Framing(config.size, config.near, config.far)
    return _prepare(config, store, SUPERVISE, supervise_chunk, (framing, method), verbose)


def ingest_chunk(file: str, bounds: Bounds) -> ArtifactRef:
    """Run the pipeline of a chunk up to the choice of samples."""
    return pairs(views(known_chunk(current_run().store, file)), bounds)


def supervise_chunk(file: str, bounds: Bounds, framing: Framing, method: Method) -> None:
    """Run the pipeline of a chunk up to the lessons of its samples."""
    chunk = known_chunk(current_run().store, file)
    samples = pairs(views(chunk), bounds)
    predicted = predictions(samples, chunk, framing, method.predictor, method.seed)
    components = method.proposer, method.tracker, method.replicas, method.votes
    lessons(samples, predicted, chunk, framing, *components)


def check(config: CorpusSettings, store: ArtifactStore) -> None:
    """Check a run before the work; InputError as in :func:`ingest_corpus`."""
    if not re10k.chunk_names(config.chunks):
        raise InputError(
            f"{config.chunks}: has no chunk (.torch); `slgaussian ingest` makes chunks of scenes"
        )
    config.withdrawn_clips()
    store.check_writable()
    check_folder(config.out)


def _prepare(
    config: CorpusSettings,
    store: ArtifactStore,
    stages: Sequence[str],
    pipeline: Callable[..., object],
    arguments: tuple[Any, ...],
    verbose: bool,
) -> Prepared:
    """Run a pipeline with these stages on all chunks, and write their tables.

    It is called with the location of a chunk, the bounds of its samples, and ``arguments``.
    """
    check(config, store)
    chunks, withdrawn = re10k.chunk_names(config.chunks), config.withdrawn_clips()
    folder, bounds = config.chunks.rstrip("/"), Bounds.of(config)
    tasks = [
        SceneTask(chunk, pipeline, (f"{folder}/{chunk}", bounds, *arguments), first="views")
        for chunk in chunks
    ]
    refresh = stages_to_refresh(config, stages)
    with open_workers(config.runner, config.workers, store, refresh) as workers:
        outcome = map_shown(tasks, workers, len(stages), "chunks", verbose)
    with writing(config.out):
        return _write(config.out, store, outcome, stages, withdrawn)


def _write(
    out: Path, store: ArtifactStore, outcome: Outcome, stages: Sequence[str], withdrawn: set[str]
) -> Prepared:
    refs = {chunk: outcome.refs[chunk] for chunk in sorted(outcome.refs)}
    failures = [*outcome.failures]
    for stage_refs in refs.values():
        for stage in stages:
            failures += [Failure(stage=stage, **bad) for bad in stage_refs[stage].meta["left_out"]]
    # A clip belongs to the first chunk that has it; a withdrawn clip belongs to none.
    owners = dict.fromkeys(withdrawn, "")
    rows = {}
    for stage in stages:
        if stage in FILES:
            rows[stage] = _join(out / FILES[stage], stage, store, refs, owners, failures)
    failures = [failure for failure in failures if failure.scene not in withdrawn]
    failures.sort(key=lambda failure: (failure.scene, failure.reason))
    write_failures(out, failures)
    return Prepared(rows, failures)


def _join(
    file: Path,
    stage: str,
    store: ArtifactStore,
    refs: Mapping[str, Mapping[str, ArtifactRef]],
    owners: dict[str, str],
    failures: list[Failure],
) -> int:
    """Concatenate the tables of all chunks, one in memory at a time; return the number of rows.

    A clip belongs to the first chunk that has it, recorded in ``owners``; further clips with the
    same key are failures. Clips that belong to no chunk are omitted.
    """
    count = 0
    schema = with_provenance(load_spec(stage).schema)
    with atomic_path(file) as name, pq.ParquetWriter(name, schema, compression="zstd") as writer:
        for chunk, stage_refs in refs.items():
            table = _own_rows(store.get(stage_refs[stage]), chunk, owners, failures)
            count += table.num_rows
            writer.write_table(table)
    return count


def _own_rows(
    table: pa.Table, chunk: str, owners: dict[str, str], failures: list[Failure]
) -> pa.Table:
    clips = table["clip"].to_pylist()
    for clip in dict.fromkeys(clips):
        if owners.setdefault(clip, chunk) not in (chunk, ""):
            reason = f"clip {clip!r} of {chunk} is also in {owners[clip]}, which is used"
            failure = Failure(clip, "views", "InputError", reason)
            if failure not in failures:
                failures.append(failure)
    names = pa.array([chunk] * len(clips), pa.string())
    table = table.set_column(table.column_names.index("chunk"), "chunk", names)
    return table.filter(pa.array([owners[clip] == chunk for clip in clips], pa.bool_()))
