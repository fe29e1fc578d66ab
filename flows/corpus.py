"""Preparation of a corpus of clips for training: views, samples and lessons."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from prefect import flow
from prefect.states import State

from flows.clip_sources import Clips, choose_samples, find_sources, map_sources
from flows.config import CorpusSettings
from flows.runners.batches import Failure, state_after, write_failures
from flows.runners.session import check_folder, check_refresh, final, run_session, writing
from flows.runners.task_runners import open_workers
from slgaussian.components.method import Method
from slgaussian.datasets import re10k
from slgaussian.datasets.clip_views import Framing
from slgaussian.datasets.configs import Bounds
from slgaussian.datasets.pair_selection import TARGETS
from slgaussian.datasets.sources import PosedFolder, Room
from slgaussian.io import atomic_path
from slgaussian.storage.provenance import with_provenance
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactStore
from tasks.chunks import packed, packed_clips
from tasks.samples import lessons, predictions

INGEST = ("views", "pairs")
SUPERVISE = (*INGEST, "predictions", "lessons")

FILES = {"views": "views.parquet", "pairs": "pairs.parquet", "lessons": "lessons.parquet"}
"""Tables in the output folder, by the stage whose artifacts are concatenated."""


@dataclass(frozen=True)
class Prepared:
    """Result of a run: number of rows of each table, and failures."""

    rows: dict[str, int]
    failures: list[Failure]

    def end(self) -> State[Prepared]:
        """Return the final state; without a row in each table, nothing is left."""
        message = ", ".join(f"{count} {stage}" for stage, count in self.rows.items())
        return final(state_after(message, self, self.failures, not all(self.rows.values())))


@flow(name="slgaussian-ingest", flow_run_name="ingest {config.out.name}", persist_result=False)
def ingest_corpus(config: CorpusSettings, verbose: bool = False) -> State[Prepared]:
    """Choose samples of all sources: ``views.parquet`` and ``pairs.parquet``.

    Scenes are also written as clips of chunks in ``chunks/``. Sources, clips and frames that could
    not be used are in ``failures.parquet`` with the reasons.

    Raises:
        InputError: If a source is missing, or the store or the output folder cannot be written.
    """
    return run_session("ingest", config, _ingest, verbose).end()


def _ingest(config: CorpusSettings, store: ArtifactStore, verbose: bool) -> Prepared:
    arguments = Bounds.of(config), config.trust_cameras, TARGETS
    prepared, clips = _prepare(config, store, INGEST, choose_samples, arguments, verbose)
    folder = config.out / "chunks"
    existing = re10k.read_index(folder) if (folder / re10k.INDEX).exists() else {}
    new = [
        refs[packed.name]
        for name, refs in clips.refs.items()
        if packed.name in refs and name not in existing and clips.owners.get(name) == name
    ]
    if new:
        re10k.write(folder, (clip for ref in new for clip in packed_clips(store, ref).values()))
    return prepared


@flow(
    name="slgaussian-supervise", flow_run_name="supervise {config.out.name}", persist_result=False
)
def supervise_corpus(config: CorpusSettings, verbose: bool = False) -> State[Prepared]:
    """Make the lessons of a corpus: ``lessons.parquet``, and the tables of :func:`ingest_corpus`.

    Raises:
        InputError: As :func:`ingest_corpus`, and if a component of the method is unknown.
    """
    return run_session("supervise", config, supervise, verbose).end()


def supervise(config: CorpusSettings, store: ArtifactStore, verbose: bool = False) -> Prepared:
    """Do the work of :func:`supervise_corpus` within any flow."""
    config.field_method.check()
    pipeline = make_lessons, lesson_arguments(config)
    return _prepare(config, store, SUPERVISE, *pipeline, verbose)[0]


def lesson_arguments(config: CorpusSettings) -> tuple[Any, ...]:
    """Return the arguments of :func:`make_lessons` besides the source."""
    framing = Framing(config.size, config.near, config.far)
    return Bounds.of(config), config.trust_cameras, framing, config.field_method


def make_lessons(
    holds: PosedFolder | Room | str,
    bounds: Bounds,
    trust_cameras: bool,
    framing: Framing,
    method: Method,
) -> None:
    """Run the pipeline from a source to the lessons of its samples."""
    chunk, samples = choose_samples(holds, bounds, trust_cameras, TARGETS)
    predictor = method.predictor, method.seed, trust_cameras
    predicted = predictions(samples, chunk, framing, *predictor)
    components = method.proposer, method.tracker, method.replicas, method.votes
    lessons(samples, predicted, chunk, framing, *components)


def check(config: CorpusSettings, store: ArtifactStore) -> None:
    """Check a run before the work; InputError as in :func:`ingest_corpus`."""
    find_sources(config.sources)
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
) -> tuple[Prepared, Clips]:
    """Run a pipeline with these stages on all sources, and write their tables."""
    check(config, store)
    check_refresh(config, (packed.name, *stages))
    with open_workers(config, store) as workers:
        clips = map_sources(config, workers, pipeline, arguments, len(stages), verbose)
    with writing(config.out):
        rows = {
            stage: _write_table(config.out / FILES[stage], stage, store, clips)
            for stage in stages
            if stage in FILES
        }
        write_failures(config.out, clips.failures)
    return Prepared(rows, clips.failures), clips


def _write_table(file: Path, stage: str, store: ArtifactStore, clips: Clips) -> int:
    """Concatenate the tables of all sources, one in memory at a time; return the number of rows.

    Only the rows of clips that the source owns are written.
    """
    count = 0
    schema = with_provenance(load_spec(stage).schema)
    with atomic_path(file) as name, pq.ParquetWriter(name, schema, compression="zstd") as writer:
        for source, stage_refs in clips.refs.items():
            table = store.get(stage_refs[stage])
            owned = [clips.owners.get(clip) == source for clip in table["clip"].to_pylist()]
            sources = pa.array([source] * len(owned), pa.string())
            table = table.set_column(table.column_names.index("chunk"), "chunk", sources)
            if "place" in table.column_names:
                named = pa.array([clips.sources[source].place or None] * len(owned), pa.string())
                table = table.set_column(table.column_names.index("place"), "place", named)
            table = table.filter(pa.array(owned, pa.bool_()))
            count += table.num_rows
            writer.write_table(table)
    return count
