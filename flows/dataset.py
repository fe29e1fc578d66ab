"""A training set that others can train on, from scenes and corpora of any format.

Chunks and scenes first go down a road to their samples, then each sample goes down its own:
the unit of work, of caching and of failure. What is done comes from the store. In the end the
samples are written into shards (:mod:`flows.shard_writing`), with a card
(:mod:`flows.data_card`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flows.clip_sources import Source, sources_of
from flows.corpus_settings import PackSettings
from flows.data_card import write_card
from flows.dataset_settings import DatasetSettings, SetSettings
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
from flows.shard_writing import Finished, write_shards
from slgaussian.datasets.pairs import Bounds
from slgaussian.datasets.places import Places
from slgaussian.datasets.training_set import SPLITS
from slgaussian.errors import InputError
from slgaussian.io import write_atomic
from slgaussian.parts.identity import KnownFile
from slgaussian.parts.method import Method
from slgaussian.semantic.split import held_out
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.all_masks import all_masks
from tasks.choices import choices
from tasks.chunks import Framing, known_chunk
from tasks.example import example
from tasks.framed import Frames, framed
from tasks.geometry import geometry
from tasks.packed import PosedFolder, Room, packed
from tasks.stage import current
from tasks.supervision import supervision
from tasks.views import views

SAMPLES = (framed, geometry, all_masks, supervision, example)
"""The stages of a sample."""

FILTER = "filter"
"""What failures call the stage that a sample was not good enough for."""


@dataclass(frozen=True)
class Made:
    """What a run leaves: how much is in the set, and what was refused."""

    samples: int
    places: int
    shards: int
    new_shards: int
    bytes: int
    failures: list[Failure]


@dataclass(frozen=True)
class Chosen:
    """A sample before anything was computed of it: its clip, and its row of spec ``choices``."""

    source: Source
    chunk: KnownFile | ArtifactRef
    cameras: str
    row: Mapping[str, Any]


def dataset(settings: DatasetSettings, store: ArtifactStore, verbose: bool = False) -> Made:
    """Make a training set, or bring one that is there up to date with its sources.

    It then holds what these sources give with these settings and nothing else. Shards of which
    nothing changed stay as they are, byte for byte. What was refused is in ``failures.parquet``.
    Needs Prefect to be ready (:func:`flows.runners.environment.orchestration`).

    Raises
    ------
    InputError
        If a source is not there, a part of the method is unknown, no sample is left, or the store
        or the folder cannot be written.
    """
    settings.built_by.check()
    sources = sources_of(settings.sources, PackSettings())
    withdrawn = settings.withdrawn_clips()
    store.check_writable()
    check_folder(settings.out)
    places = Places()
    failures: list[Failure] = []
    found = _choose(settings, store, sources, places, failures, verbose)
    chosen = [one for one in found if one.row["clip"] not in withdrawn]
    finished = _finish(settings, store, chosen, places, failures, verbose)
    failures.sort(key=lambda failure: (failure.scene, failure.stage, failure.reason))
    write_atomic(settings.out / "failures.parquet", failures_file(failures))
    if not finished:
        raise InputError(
            f"{settings.out}: no sample is left of {len(sources)} sources; the reasons are in "
            f"{settings.out / 'failures.parquet'}"
        )
    versions = {stage.name: stage.version for stage in (packed, views, choices, *SAMPLES)}
    try:
        written = write_shards(settings.out, finished, store, int(settings.shard_mb * 1e6))
        of_sample = {one.row["sample"]: one.source for one in chosen}
        write_card(settings.out, settings, of_sample, failures, versions)
    except OSError as error:
        raise InputError(
            f"{settings.out}: cannot be written ({error.strerror or error}); what it is made of is "
            "kept in the store, so make room there, or choose another folder, and run again"
        ) from error
    return Made(
        samples=len(finished),
        places=len({one.place for one in finished}),
        shards=written.shards,
        new_shards=written.new,
        bytes=written.bytes,
        failures=failures,
    )


def choose_of_chunk(file: str, bounds: Bounds, targets: int) -> ArtifactRef:
    """The road of a chunk to its samples."""
    return choices(views(known_chunk(current().store, file)), bounds, targets)


def choose_of_scene(source: PosedFolder | Room, bounds: Bounds, targets: int) -> ArtifactRef:
    """The road of a scene to its samples: it becomes a chunk first."""
    return choices(views(packed(source)), bounds, targets)


def make_example(
    chunk: KnownFile | ArtifactRef,
    frames: Frames,
    framing: Framing,
    method: Method,
    trust_cameras: bool,
    known: Mapping[str, Any],
    images: str,
    with_gaussians: bool,
) -> ArtifactRef:
    """The road of a sample: the first stages of :func:`flows.road.score_scene`, with targets."""
    sample = framed(chunk, frames, framing)
    base = geometry(sample, method.predictor, method.seed, trust_cameras)
    ids = all_masks(sample, base, method.proposer, method.tracker, method.replicas)
    bank = supervision(sample, base, ids, method.encoder, method.codes, method.seed, method.bank)
    return example(sample, base, ids, bank, known, images, with_gaussians)


@job_flow("slgaussian-dataset")
def take_roads(pool: WorkerPool, jobs: Sequence[Job], progress: Progress) -> Outcome:
    """Take chunks, scenes or samples down their road."""
    return work_through_all(jobs, pool, progress)


def _taken(
    settings: DatasetSettings,
    store: ArtifactStore,
    jobs: Sequence[Job],
    stages: int,
    unit: str,
    verbose: bool,
) -> Outcome:
    """What was made of the jobs, whose progress is shown."""
    if not jobs:
        return Outcome()
    progress = Progress(len(jobs), stages, verbose=verbose, unit=unit)
    with progress:
        outcome = take_roads(store, settings.runner, settings.workers, jobs, progress)
    progress.summary()
    return outcome


def _choose(
    settings: DatasetSettings,
    store: ArtifactStore,
    sources: Sequence[Source],
    places: Places,
    failures: list[Failure],
    verbose: bool,
) -> list[Chosen]:
    """The samples of all sources; ``places`` gets to know the photographs of all clips."""
    asked = Bounds(**settings.bounds()), settings.targets
    files = [source for source in sources if isinstance(source.holds, str)]
    scenes = [source for source in sources if not isinstance(source.holds, str)]
    of_files = [Job(s.name, choose_of_chunk, (s.holds, *asked), views.name) for s in files]
    of_scenes = [Job(s.name, choose_of_scene, (s.holds, *asked), packed.name) for s in scenes]
    refs: dict[str, dict[str, ArtifactRef]] = {}
    for jobs, stages, unit in ((of_files, 2, "chunks"), (of_scenes, 3, "scenes")):
        outcome = _taken(settings, store, jobs, stages, unit, verbose)
        refs |= outcome.refs
        failures += outcome.failures
    owners: dict[str, str] = {}
    chosen: list[Chosen] = []
    for source in sources:
        own = refs.get(source.name)
        if own is None:
            continue
        failures += [
            Failure(stage=stage, **bad)
            for stage, ref in own.items()
            for bad in ref.meta.get("left_out", ())
        ]
        chosen += _of_source(source, own, store, places, owners, failures)
    return chosen


def _of_source(
    source: Source,
    own: Mapping[str, ArtifactRef],
    store: ArtifactStore,
    places: Places,
    owners: dict[str, str],
    failures: list[Failure],
) -> Iterator[Chosen]:
    """The samples of a source, without those of a clip that another one has, its owner."""
    if isinstance(source.holds, str):
        chunk: KnownFile | ArtifactRef = known_chunk(store, source.holds)
        cameras = "given"
    else:
        chunk = own[packed.name]
        cameras = own[packed.name].meta["cameras"]
    seen = store.get(own[views.name]).select(["clip", "digest"]).to_pylist()
    for clip in dict.fromkeys(row["clip"] for row in seen):
        if owners.setdefault(clip, source.name) != source.name:
            reason = (
                f"clip {clip!r} of {source.name} is in {owners[clip]} too, which is the one used"
            )
            failures.append(Failure(clip, views.name, "InputError", reason))
            continue
        places.add(clip, (row["digest"] for row in seen if row["clip"] == clip), source.place)
    for row in store.get(own[choices.name]).to_pylist():
        if owners[row["clip"]] == source.name:
            yield Chosen(source, chunk, cameras, row)


def _finish(
    settings: DatasetSettings,
    store: ArtifactStore,
    chosen: Sequence[Chosen],
    places: Places,
    failures: list[Failure],
    verbose: bool,
) -> list[Finished]:
    """The samples that went down their road and are good enough, in the order of their names."""
    framing = Framing(settings.size, settings.near, settings.far)
    jobs = []
    for one in chosen:
        row = dict(one.row)
        frames = Frames(row["sample"], row["clip"], tuple(row["context"]), tuple(row["targets"]))
        known = {**row, "cameras": one.cameras}
        given = (one.chunk, frames, framing, settings.built_by, settings.trust_cameras, known)
        stored = settings.images, settings.gaussians
        jobs.append(Job(row["sample"], make_example, (*given, *stored), framed.name))
    outcome = _taken(settings, store, jobs, len(SAMPLES), "samples", verbose)
    failures += outcome.failures
    abouts = {name: own[example.name].meta["about"] for name, own in outcome.refs.items()}
    for about in abouts.values():
        places.seen_in(about["clip"], about["url"])
    by_clip = places.by_clip()
    finished = []
    for name, about in sorted(abouts.items()):
        why = refused(about, settings)
        if why is not None:
            failures.append(Failure(name, FILTER, "Filtered", why))
            continue
        place = by_clip[about["clip"]]
        split = SPLITS[held_out(place, settings.held_out)]
        finished.append(Finished(outcome.refs[name][example.name], place, split))
    return finished


def refused(about: Mapping[str, Any], settings: SetSettings) -> str | None:
    """Why a sample is not good enough for the set, or None."""
    unlabelled = max(about["unlabelled"], about["unlabelled_targets"])
    if unlabelled > settings.max_unlabelled:
        return (
            f"{unlabelled:.2f} of the pixels of its context views or targets are without an id, "
            f"above max_unlabelled {settings.max_unlabelled:g}"
        )
    if about["confirmed"] < settings.min_confirmed:
        return (
            f"a second view confirms {about['confirmed']:.2f} of its depth, below min_confirmed "
            f"{settings.min_confirmed:g}"
        )
    return None
