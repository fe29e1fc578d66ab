"""What settings cost and are worth: a sweep over one's own data, and a proposal.

Every setting takes the road of the main job (:mod:`flows.road`), whose stages are found in the
store where the changed setting does not touch them. One scene at a time is worked on, so that
seconds are those of the whole machine.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from flows.jobs import evaluation, labels, photographs
from flows.pipeline import check_folder, scenes_of
from flows.road import weigh_settings
from flows.runners.progress import Progress
from flows.runners.shard import Failure, Job
from flows.runners.worker_pool import WorkerPool, failures_file, job_flow, work_through_all
from flows.settings import SceneSettings, Settings
from flows.sweep import Variant, variants
from flows.tradeoff_settings import TradeoffSettings
from slgaussian.benchmark import pictures
from slgaussian.benchmark.outputs import write_table
from slgaussian.benchmark.tradeoffs import (
    Proposal,
    Wanted,
    Weighed,
    pictured,
    propose,
    render_tradeoffs,
    weigh,
)
from slgaussian.build import build_field
from slgaussian.cameras.trajectories import between
from slgaussian.datasets.procedural.reader import read as made_up_room
from slgaussian.errors import InputError
from slgaussian.kernels import threads
from slgaussian.parts.method import Method
from slgaussian.scene import Sample
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore, write_atomic
from tasks.artifacts import get_field, result_from_arrays, sample_from_arrays

TABLE = "tradeoffs"
STAGES = {
    "read": "ingest",
    "geometry": "geometry",
    "masks": "masks",
    "supervision": "supervision",
    "field": "field",
}
"""What makes a field of photographs: the column of the spec, and the stage."""

SCORES = ("iou", "miou", "hit_mask", "psnr", "ssim", "target_abs_rel")
"""Columns that are metrics of a scene's result."""

ROAD = 8
"""Stages of a scene with other settings than those given: those of the road, and agreement."""

Refs = Mapping[str, ArtifactRef]


@dataclass(frozen=True)
class Swept:
    """What a sweep leaves: rows by setting, the proposal, failures, and the page."""

    weighed: list[Weighed]
    proposal: Proposal
    failures: list[Failure]
    page: Path


def run(settings: TradeoffSettings, store: ArtifactStore, verbose: bool = False) -> Swept:
    """Sweep the settings over the scenes; write table and page to ``settings.out``.

    Needs Prefect to be ready (:func:`flows.runners.environment.orchestration`).

    Raises
    ------
    InputError
        If there is nothing to do, or no scene goes through with the settings as given.
    """
    scenes, said = scenes_of(settings)
    rows = variants(settings.given, settings.seeds)
    settings.built_by.check()
    store.check_writable()
    check_folder(settings.out)
    progress = Progress(len(scenes), ROAD - 1, verbose=verbose)
    for text in said:
        progress.line(text)
    warm_up(settings.built_by)
    made = sweep(store, "threads", 1, rows, scenes, progress)
    found = [row for own in made.rows for row in own]
    if not found:
        reason = made.failures[0].reason if made.failures else "none had the settings as given"
        raise InputError(f"tradeoffs: no scene went through; the first because {reason}")
    weighed = weigh(found)
    wanted = Wanted(settings.seconds, settings.memory, settings.error)
    proposal = propose(weighed, wanted)
    _write(settings, store, made, weighed, proposal)
    return Swept(weighed, proposal, made.failures, settings.out / "tradeoffs.html")


def warm_up(method: Method) -> None:
    """Build a tiny field and ask it, so that what a process loads once is in no row's seconds."""
    threads.limit(1)
    room = made_up_room(seed=1, objects=4, views=3, height=64, width=64)
    sample = room.sample(["view_00", "view_02"], near=0.8, far=12.0)
    with suppress(InputError):  # of parts that cannot do so little, the first row has the loading
        field = build_field(sample, replace(method, replicas=1), True)
        view = field.render(field.cameras[next(iter(field.cameras))])
        view.query("floor").mask  # noqa: B018  (drawn when first looked at)


@dataclass
class _Made:
    """What was made: by setting the rows of its scenes, and what stages made of the first."""

    rows: list[list[dict[str, Any]]]
    shown: dict[tuple[str, str], Refs]
    failures: list[Failure]
    machines: set[str]


@job_flow("slgaussian-tradeoffs")
def sweep(
    pool: WorkerPool,
    rows: Sequence[tuple[Variant, Settings]],
    scenes: Sequence[SceneSettings],
    progress: Progress,
) -> _Made:
    """Take all scenes down the road with the first settings, then with all others."""
    (first, given), *others = rows
    with progress:
        jobs = [_job(first, given, scene) for scene in scenes]
        outcome = work_through_all(jobs, pool, progress)
    references = {
        scene.name: outcome.refs[name]
        for scene in scenes
        if (name := _named(first, scene)) in outcome.refs
    }
    through = [scene for scene in scenes if scene.name in references]
    more = [
        _job(one, settings, scene, references[scene.name])
        for one, settings in others
        for scene in through
    ]
    failures, refs = list(outcome.failures), dict(outcome.refs)
    if more:
        with Progress(len(more), ROAD, progress.verbose, unit="settings") as course:
            rest = work_through_all(more, pool, course)
        course.summary()
        failures += rest.failures
        refs |= rest.refs
    found: list[list[dict[str, Any]]] = []
    shown: dict[tuple[str, str], Refs] = {}
    known: list[Any] = []
    for one, settings in rows:
        own = [(scene, refs[name]) for scene in through if (name := _named(one, scene)) in refs]
        same = [(by["field"].digest, by["benchmark"].digest) for _, by in own]
        # As of a size that the photographs do not reach.
        if len(own) < len(through) or not own or same in known:
            continue
        known.append(same)
        found.append([_row(one, settings, scene, by, pool.store) for scene, by in own])
        shown[one.factor, one.name] = own[0][1]
    machines = {
        ref.meta.get("processor", "an unknown processor")
        for by in refs.values()
        for ref in by.values()
    }
    return _Made(found, shown, failures, machines)


def _named(one: Variant, scene: SceneSettings) -> str:
    return f"{scene.name}: {one.factor}, {one.name}"


def _job(
    one: Variant, settings: Settings, scene: SceneSettings, reference: Refs | None = None
) -> Job:
    asked = replace(evaluation(settings, scene), protocols=("slgaussian",), drawn=False)
    given = photographs(settings, scene), labels(scene), settings.built_by
    road = *given, settings.trust_cameras, asked, None if reference is None else dict(reference)
    return Job(_named(one, scene), weigh_settings, road)


def _row(
    one: Variant, settings: Settings, scene: SceneSettings, refs: Refs, store: ArtifactStore
) -> dict[str, Any]:
    """A row of the spec ``tradeoffs``."""
    stages = {name: refs[stage].meta for name, stage in STAGES.items()}
    grown = [meta["grown"] for meta in stages.values() if meta.get("grown") is not None]
    worked = [m["processor_seconds"] for m in stages.values() if "processor_seconds" in m]
    result, field = refs["benchmark"], refs["field"].meta
    scores = result_from_arrays(store.get(result), {}, with_images=False).scene_metrics
    images = store.get(refs["ingest"])["images"]
    return {
        "factor": one.factor,
        "setting": one.name,
        "options": one.options,
        "dataset": scene.dataset,
        "scene": scene.name,
        "place": scene.asked.get("place"),
        "height": images.shape[1],
        "width": images.shape[2],
        **{f"{name}_seconds": meta["seconds"] for name, meta in stages.items()},
        "processor_seconds": sum(worked) if len(worked) == len(stages) else None,
        "query_seconds": result.meta["times"].get("first_query"),
        "grown_bytes": max(grown, default=None),
        "gaussians": field["account"]["gaussians_made"],
        "kept": field["account"]["gaussians_kept"],
        "objects": field["objects"],
        **{name: scores.get(name) for name in SCORES},
        "agreement": refs["agreement"].meta["covering"] if "agreement" in refs else 1.0,
    }


def _write(
    settings: TradeoffSettings,
    store: ArtifactStore,
    made: _Made,
    weighed: Sequence[Weighed],
    proposal: Proposal,
) -> None:
    """Write the table, the summary, the page and who was left out."""
    out = settings.out
    rows = [row for own in made.rows for row in own]
    table = pa.Table.from_pylist(rows, schema=load_spec(TABLE).schema)
    write_table(TABLE, table, out)
    write_atomic(out / "failures.parquet", failures_file(made.failures))
    here = threads.processor()
    host = {"processor": here, "elsewhere": sorted(made.machines - {here})}
    content: dict[str, Any] = {
        "host": host,
        "settings": [one.as_json() for one in weighed],
        **proposal.as_json(),
    }
    text = json.dumps(content, indent=1, ensure_ascii=False) + "\n"
    write_atomic(out / "tradeoffs.json", text.encode())
    sample = sample_from_arrays(store.get(next(iter(made.shown.values()))["ingest"]))
    drawn = {
        (one.factor, one.setting): _view(store, sample, made.shown[one.factor, one.setting])
        for one in pictured(weighed, proposal)
    }
    failures = [vars(failure) for failure in made.failures]
    report = render_tradeoffs(weighed, proposal, host, failures, drawn)
    for name, page in (("html", report.html), ("md", report.markdown)):
        write_atomic(out / f"tradeoffs.{name}", page.encode())


def _view(store: ArtifactStore, sample: Sample, refs: Refs) -> dict[str, np.ndarray]:
    """A target of a sample, or halfway without one: the photograph, and what a field shows."""
    field = get_field(store, refs["field"])
    if sample.targets:
        name, camera = sample.targets[0].name, sample.targets[0].camera
        images = {f"photo/{name}": sample.targets[0].image}
    else:
        name, images = "halfway", {}
        camera = between(sample.context[0].camera, sample.context[1].camera, 0.5)
    view = field.render(camera)
    ids = pictures.paint_labels(view.ids, view.rgb)
    return {**images, f"render/{name}": view.rgb, f"ids/{name}": ids}
