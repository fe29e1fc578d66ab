"""The pipeline of a scene, from photographs to scores, as a sequence of stages.

A stage is a Prefect task that first looks up its result in the store (:mod:`tasks.stage`).
:func:`slgaussian.build.build_field` does the same steps from sample to field in memory, without a
store. :mod:`flows.runners.batches` runs the pipelines of many scenes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from inspect import getclosurevars
from typing import Any

from flows.config import SceneSettings, Settings
from flows.runners.batches import SceneTask
from slgaussian.benchmark.baselines import ROWS, Row
from slgaussian.benchmark.evaluate import EvaluationSettings
from slgaussian.components.method import Method
from slgaussian.datasets.sources import Photographs
from slgaussian.errors import InputError, did_you_mean
from slgaussian.language.rules import Rules
from slgaussian.scene import Size
from slgaussian.storage.store import ArtifactRef
from tasks.benchmark import attribution, baselines, benchmark
from tasks.scene import Labels, field, geometry, ingest, masks, supervision, truth
from tasks.stage import Stage

FIELD_METHOD = "slgaussian"

TARGET_SIZE = "auto"
"""Size of the targets in every run, as scores at different sizes are not comparable."""


def score_scene(
    photographs: Photographs,
    labels: Labels,
    method: Method,
    trust_cameras: bool,
    settings: EvaluationSettings,
) -> None:
    """Build the field of a scene, score it on its ground truth, and attribute each miss."""
    *refs, _, built = answer_scene(photographs, labels, method, trust_cameras, settings)
    # Queries without ground truth cannot be misses.
    attribution(*refs, built, method, replace(settings, queries=()))


def answer_scene(
    photographs: Photographs,
    labels: Labels,
    method: Method,
    trust_cameras: bool,
    settings: EvaluationSettings,
) -> tuple[ArtifactRef, ...]:
    """Build the field of a scene and answer its queries.

    Returns the refs of sample, truth, Gaussians, label maps and field.
    """
    sample = ingest(photographs)
    scene_truth = truth(sample, labels.of_views(sample.meta["targets"]))
    gaussians = geometry(sample, method.predictor, method.seed, trust_cameras)
    ids = masks(sample, gaussians, method.proposer, method.tracker, method.replicas, method.votes)
    bank = supervision(
        sample, gaussians, ids, method.encoder, method.codes, method.seed, method.bank
    )
    built = field(sample, gaussians, ids, bank, method)
    benchmark(sample, scene_truth, gaussians, ids, built, method.encoder, settings)
    return sample, scene_truth, gaussians, ids, built


STAGES = tuple(
    called
    for pipeline in (answer_scene, score_scene)
    for called in getclosurevars(pipeline).globals.values()
    if isinstance(called, Stage)
)
"""The stages that :func:`score_scene` calls, in order."""


def score_baseline(refs: Mapping[str, ArtifactRef], *arguments: Any) -> None:
    """Score a baseline on the queries of the field of a scene.

    ``refs`` are the results of the stages of :func:`score_scene`, and ``arguments`` the others of
    the stage :func:`tasks.benchmark.baselines`.
    """
    inputs = (refs[stage] for stage in ("ingest", "truth", "geometry", "masks", "field"))
    baselines(*inputs, *arguments)


def scene_task(settings: Settings, scene: SceneSettings, variant: str = "") -> SceneTask:
    """Return the task of a scene, from its photographs to its scores.

    If it is of a ``variant`` of the method of this name, without pictures and attribution.
    """
    name, scoring = scene.name, evaluation(settings, scene)
    pipeline: Callable[..., object] = score_scene
    if variant:
        name, pipeline = method_task_name(scene.name, variant), answer_scene
        scoring = replace(scoring, method=variant, drawn=False)
    inputs = photographs(settings, scene), labels(scene)
    arguments = *inputs, settings.field_method, settings.trust_cameras, scoring
    return SceneTask(name, pipeline, arguments)


def target_size(size: Size) -> Size:
    """Return the size of targets for views of ``size``.

    A given height and width crops the views, so it also applies to the targets.
    """
    return TARGET_SIZE if isinstance(size, str) else size


def photographs(settings: Settings, scene: SceneSettings) -> Photographs:
    """Return the photographs of a scene in a run, with size and depth range."""
    size = scene.size or settings.size
    return Photographs(
        scene.name,
        scene.format,
        scene.path,
        scene.options,
        tuple(scene.context),
        tuple(scene.targets),
        size,
        scene.near or settings.near,
        scene.far or settings.far,
        judged=target_size(size),
    )


def labels(scene: SceneSettings) -> Labels:
    """Return the source of a scene's ground truth."""
    return Labels(scene.labels, tuple(scene.targets), tuple(scene.categories))


def evaluation(settings: Settings, scene: SceneSettings) -> EvaluationSettings:
    """Return the evaluation settings of a scene in a run."""
    place = scene.options.get("scene")
    return EvaluationSettings(
        method=settings.method,
        dataset=scene.dataset,
        place=None if place is None else str(place),
        queries=tuple(scene.queries),
        rules=Rules.of(settings),
    )


def chosen_baselines(names: Sequence[str]) -> dict[str, Row]:
    """Return the baselines of these names, in the order of the table of methods.

    ``all`` selects all. Our own method, which is always scored, is not included.

    Raises:
        InputError: If there is no such method.
    """
    for name in names:
        if name not in (*ROWS, "all"):
            raise InputError(
                f"against: found {name!r}, expected all, or of these: {'; '.join(ROWS)}"
                f"{did_you_mean(name, ROWS)}"
            )
    rows = ROWS if "all" in names else names
    return {name: row for name, row in ROWS.items() if name != FIELD_METHOD and name in rows}


def baseline_tasks(
    settings: Settings,
    scenes: Sequence[SceneSettings],
    refs: Mapping[str, Mapping[str, ArtifactRef]],
) -> list[SceneTask]:
    """Return a task for each baseline and completed scene, whose results are ``refs``."""
    scene_tasks = []
    for scene in scenes:
        scoring = evaluation(settings, scene)
        for name, row in chosen_baselines(settings.against).items():
            rules = Rules(**{**dict(scoring.rules), **row.rules})
            changed = replace(scoring, method=name, rules=rules, drawn=False)
            baseline = row.method, dict(row.settings), row.package_identity
            arguments = dict(refs[scene.name]), settings.field_method, changed, *baseline
            task_name = method_task_name(scene.name, name)
            scene_tasks.append(SceneTask(task_name, score_baseline, arguments, baselines.name))
    return scene_tasks


def method_task_name(scene: str, method: str) -> str:
    """Return the task name of a method on a scene, also used in failures."""
    return f"{scene}: {method}"
