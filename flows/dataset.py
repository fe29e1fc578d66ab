"""Production of a training set for any network from scenes and corpora of any format.

One pipeline chooses the samples of each chunk and scene, a second one computes each sample, which
is the unit of work, of caching and of failure. Then the samples are written to shards
(:mod:`slgaussian.datasets.shards`) as a version of the set
(:mod:`slgaussian.datasets.set_versions`) with a data card (:mod:`slgaussian.datasets.data_card`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from prefect import flow
from prefect.states import State

from flows import corpus
from flows.clip_sources import Clips, Source, choose_samples, find_sources, map_sources
from flows.config import DatasetSettings
from flows.runners.batches import Failure, SceneTask, map_scenes, state_after, write_failures
from flows.runners.progress import Progress
from flows.runners.session import check_refresh, final, run_session, writing
from flows.runners.task_runners import open_workers
from slgaussian.components.method import Method
from slgaussian.datasets.clip_views import Framing
from slgaussian.datasets.configs import Bounds
from slgaussian.datasets.data_card import UNKNOWN, describe_set
from slgaussian.datasets.leaks import check_shards
from slgaussian.datasets.scene_grouping import VIEW_COLUMNS, Places
from slgaussian.datasets.set_versions import add_version, read_versions
from slgaussian.datasets.shards import (
    read_index,
    retire_shards,
    write_index,
    write_shards,
)
from slgaussian.datasets.splits import TEST, Split, assign_split, read_split
from slgaussian.errors import InputError, did_you_mean
from slgaussian.io import KnownFile
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.chunks import known_chunk, packed, pairs, views
from tasks.example import example
from tasks.samples import all_masks, framed
from tasks.scene import geometry, supervision

SAMPLES = (framed, geometry, all_masks, supervision, example)
"""Stages of a sample."""

SETTINGS = (
    "size", "targets", "held_out", "images", "shard_mb", "keep_old_days", "near", "far",
    "trust_cameras", "licences",
)  # fmt: skip
"""Settings of a version of the set besides those of the method and the choice of samples."""


@dataclass(frozen=True)
class TrainingSetResult:
    """Result of a run: number and size of the version of the set, refused samples, and its split.

    ``split`` tells as text how places were split.
    """

    version: int
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
    are unchanged stay the same, byte for byte; others stay as long as readers may need them.
    Refused samples are in ``failures.parquet``.

    Raises:
        InputError: If a source is missing, a component is unknown, a licence is of no source, no
            sample is left, the split leaks, or the store or the folder cannot be written.
    """
    result = run_session("dataset", config, _make, verbose)
    message = f"{result.samples} samples in {config.out}"
    return final(state_after(message, result, result.failures, nothing_left=False))


def check(config: DatasetSettings, store: ArtifactStore) -> None:
    """Check a run before the work; InputError as in :func:`make_training_set`."""
    config.field_method.check()
    corpus.check(config, store)
    sources = find_sources(config.sources)
    for name in config.licences:
        if not any(_has_name(source, name) for source in sources):
            titles = list(dict.fromkeys(source.title for source in sources))
            raise InputError(
                f"licences: found {name!r}, expected one of the sources {', '.join(titles)}"
                f"{did_you_mean(name, titles)}"
            )


def _has_name(source: Source, name: str) -> bool:
    return name in (source.title, source.location) or source.location.endswith(f"/{name}")


def _make(config: DatasetSettings, store: ArtifactStore, verbose: bool) -> TrainingSetResult:
    check(config, store)
    stages = packed, views, pairs, *SAMPLES
    check_refresh(config, [stage.name for stage in stages])
    with open_workers(config, store) as workers:
        arguments = Bounds.of(config), config.trust_cameras, config.targets
        clips = map_sources(config, workers, choose_samples, arguments, 2, verbose)
        places = Places()
        tasks = _sample_tasks(config, clips, store, places)
        progress = Progress(len(tasks), len(SAMPLES), verbose, unit="samples")
        outcome = map_scenes(tasks, workers, progress)
    samples = {name: outcome.refs[name][example.name] for name in sorted(outcome.refs)}
    owned = {ref.meta["about"]["clip"] for ref in samples.values()}
    # What was held out stays so: a network of an earlier set may have learnt the rest.
    split = assign_split(places, owned, config.held_out, read_split(config.out), winner=TEST)
    rows = [
        _index_row(config, ref.meta, split, clips)
        for ref in samples.values()
        if ref.meta["about"]["clip"] in split.sides
    ]
    leaking = [Failure(c, "split", "InputError", why) for c, why in split.left_out.items()]
    failures = clips.failures + outcome.failures + leaking
    with writing(config.out):
        write_failures(config.out, failures)
    if not rows:
        raise InputError(
            f"{config.out}: no sample is left of the sources; the reasons are in "
            f"{config.out / 'failures.parquet'}"
        )
    settings = {
        **config.model_dump(mode="json", include=set(SETTINGS)),
        **dict(Bounds.of(config)),
        "method": {
            key: value for key, value in config.field_method.identity().items() if key != "lifting"
        },
        "stages": {stage.name: stage.version for stage in stages},
    }
    refused = {failure.scene: failure.reason for failure in reversed(failures)}
    withdrawn, out = config.withdrawn_clips(), config.out

    def read(sample: str) -> bytes:
        return store.get(samples[sample])["tar"].tobytes()

    with writing(out):
        before, used = read_index(out), {n for v in read_versions(out) for n in v["shards"]}
        written = write_shards(out, rows, read, config.shard_mb * 1e6, used)
        check_shards(out, written.index, written.new)
        split.write(out)
        manifest = add_version(out, before, written, settings, withdrawn, refused, clips.owners)
        write_index(out, written.index)  # from now on readers see this version
        retire_shards(out, written.shards, config.keep_old_days)
        describe_set(out, manifest)
    counts = len(rows), len({row["place"] for row in rows}), len(written.shards), len(written.new)
    return TrainingSetResult(manifest["version"], *counts, written.bytes, failures, split.summary)


def _index_row(
    config: DatasetSettings, meta: Mapping[str, Any], split: Split, clips: Clips
) -> dict[str, Any]:
    """Return the row of a sample in the index, without its position in a shard."""
    clip = meta["about"]["clip"]
    source = clips.sources[clips.owners[clip]]
    licences = (text for name, text in config.licences.items() if _has_name(source, name))
    return {
        **meta["about"],
        "place": split.places[clip],
        "split": split.sides[clip],
        "source": source.title,
        "licence": next(licences, UNKNOWN),
        "bytes": meta["length"],
        "digest": meta["sha256"],
    }


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
                method = config.field_method, config.trust_cameras
                measured = {**row, "cameras": cameras}
                arguments = chunk, frames, framing, *method, measured, config.images
                tasks.append(SceneTask(row["sample"], make_example, arguments, framed.name))
    return tasks
