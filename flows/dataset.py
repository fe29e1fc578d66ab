"""Production of a training set for any network from scenes and corpora of any format.

One pipeline chooses the samples of each chunk and scene, a second one computes each sample, which
is the unit of work, of caching and of failure. Then the samples are written to shards
(:mod:`flows.shard_writing`) with a data card (:mod:`flows.data_card`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from prefect import flow
from prefect.states import State

from flows import corpus
from flows.clip_sources import Clips, choose_samples, map_sources
from flows.config import DatasetSettings
from flows.data_card import write_card
from flows.runners.batches import Failure, SceneTask, map_with_progress, write_failures
from flows.runners.session import final_state, run_session, stages_to_refresh, writing
from flows.runners.task_runners import open_workers
from flows.shard_writing import Finished, write_shards
from slgaussian.components.method import Method
from slgaussian.datasets.configs import Bounds
from slgaussian.datasets.scene_grouping import VIEW_COLUMNS, Places
from slgaussian.datasets.splits import TEST, assign_split, read_split
from slgaussian.errors import InputError
from slgaussian.io import KnownFile
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.chunks import Framing, known_chunk, packed, pairs, views
from tasks.example import example
from tasks.samples import all_masks, framed
from tasks.scene import geometry, supervision

SAMPLES = (framed, geometry, all_masks, supervision, example)
"""Stages of a sample."""


@dataclass(frozen=True)
class TrainingSetResult:
    """Result of a run: the size of the set, refused samples, and how it was split, as text."""

    samples: int
    places: int
    shards: int
    new_shards: int
    bytes: int
    failures: list[Failure]
    split: str


@flow(name="slgaussian-dataset", flow_run_name="dataset {config.out.name}", persist_result=False)
def make_training_set(config: DatasetSettings, verbose: bool = False) -> State[TrainingSetResult]:
    """Make a training set, or update an existing one.

    The set then has exactly the samples of these sources with these settings. Shards whose samples
    are unchanged stay the same, byte for byte. Refused samples are in ``failures.parquet``.

    Raises:
        InputError: If a source is missing, a component is unknown, no sample is left, the split
            leaks, or the store or the folder cannot be written.
    """
    result = run_session("dataset", config, lambda store: _make(config, store, verbose))
    return final_state(f"{result.samples} samples in {config.out}", result, result.failures)


def check(config: DatasetSettings, store: ArtifactStore) -> None:
    """Check a run before the work; InputError as in :func:`make_training_set`."""
    config.built_by.check()
    corpus.check(config, store)


def _make(config: DatasetSettings, store: ArtifactStore, verbose: bool) -> TrainingSetResult:
    check(config, store)
    stages = packed, views, pairs, *SAMPLES
    refresh = stages_to_refresh(config, [stage.name for stage in stages])
    limits = config.max_failures, config.only_missing
    with open_workers(config.runner, config.workers, store, refresh, *limits) as workers:
        arguments = Bounds.of(config), config.trust_cameras, config.targets
        clips = map_sources(config, workers, choose_samples, arguments, 2, verbose)
        places = Places()
        tasks = _sample_tasks(config, clips, store, places)
        outcome = map_with_progress(tasks, workers, len(SAMPLES), "samples", verbose)
    results = [outcome.refs[name][example.name] for name in sorted(outcome.refs)]
    owned = {ref.meta["about"]["clip"] for ref in results}
    # What was held out stays so: a network of an earlier set may have learnt the rest.
    split = assign_split(places, owned, config.held_out, read_split(config.out), winner=TEST)
    finished = [
        Finished(ref, split.places[clip], split.sides[clip])
        for ref in results
        if (clip := ref.meta["about"]["clip"]) in split.sides
    ]
    leaking = [Failure(c, "split", "InputError", why) for c, why in split.left_out.items()]
    failures = clips.failures + outcome.failures + leaking
    write_failures(config.out, failures)
    if not finished:
        raise InputError(
            f"{config.out}: no sample is left of the sources; the reasons are in "
            f"{config.out / 'failures.parquet'}"
        )
    versions = {stage.name: stage.version for stage in stages}
    with writing(config.out):
        written = write_shards(config.out, finished, store, int(config.shard_mb * 1e6), split)
        masked = sum("opaque" in item.ref.meta for item in finished)
        write_card(config.out, config, len(failures), versions, masked)
    places_left = {item.place for item in finished}
    return TrainingSetResult(len(finished), len(places_left), *written, failures, split.summary)


def make_example(
    chunk: KnownFile | ArtifactRef,
    frames: Mapping[str, Any],
    framing: Framing,
    method: Method,
    trust_cameras: bool,
    known: Mapping[str, Any],
    images: str,
) -> ArtifactRef:
    """Run the first stages of :func:`flows.scene.answer_scene` on a sample, with its targets."""
    sample = framed(chunk, frames, framing)
    base = geometry(sample, method.predictor, method.seed, trust_cameras)
    ids = all_masks(sample, base, method.proposer, method.tracker, method.replicas, method.votes)
    bank = supervision(sample, base, ids, method.encoder, method.codes, method.seed, method.bank)
    return example(sample, base, ids, bank, known, images)


def _sample_tasks(
    config: DatasetSettings, clips: Clips, store: ArtifactStore, places: Places
) -> list[SceneTask]:
    """Return the tasks of all samples; add the photographs of clips to ``places``."""
    framing = Framing(config.size, config.near, config.far)
    tasks = []
    for name, refs in clips.refs.items():
        source = clips.sources[name]
        if isinstance(source.holds, str):
            chunk: KnownFile | ArtifactRef = known_chunk(store, source.holds)
            cameras = "given"
        else:
            chunk = refs[packed.name]
            cameras = chunk.meta["cameras"]
        table = store.get(refs[views.name]).select(VIEW_COLUMNS).to_pylist()
        owned = [row for row in table if clips.owners.get(row["clip"]) == name]
        places.add_views({**row, "place": source.place} for row in owned)
        for row in store.get(refs[pairs.name]).drop_columns("chunk").to_pylist():
            if clips.owners.get(row["clip"]) == name:
                frames = {key: row[key] for key in ("sample", "clip", "context", "targets")}
                method = config.built_by, config.trust_cameras
                measured = {**row, "cameras": cameras}
                arguments = chunk, frames, framing, *method, measured, config.images
                tasks.append(SceneTask(row["sample"], make_example, arguments, framed.name))
    return tasks
