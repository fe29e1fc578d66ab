"""The jobs of a run: which road each scene takes, and what it is called with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from flows.road import score_baseline, score_scene
from flows.runners.shard import Job
from flows.settings import SceneSettings, Settings
from slgaussian.benchmark.baselines import ROWS, Row
from slgaussian.benchmark.evaluate import EvaluationSettings
from slgaussian.errors import InputError, did_you_mean
from slgaussian.language.query import Rules
from slgaussian.parts.method import Method
from slgaussian.scene import Size
from slgaussian.storage.store import ArtifactRef
from tasks.baselines import baselines
from tasks.ingest import Photographs
from tasks.truth import Labels

OURS = "slgaussian"

JUDGED = "auto"
"""Size of the targets of every run, whatever it works at: scores of other sizes do not compare."""


def judged_at(size: Size) -> Size:
    """The size of targets where scenes are worked on at ``size``: a pair crops, and so they too."""
    return JUDGED if isinstance(size, str) else size


def scene_job(settings: Settings, method: Method, scene: SceneSettings) -> Job:
    """From the photographs of a scene to its scores."""
    asked = evaluation(settings, scene)
    given = photographs(settings, scene), labels(scene), method, settings.trust_cameras, asked
    return Job(scene.name, score_scene, given)


def photographs(settings: Settings, scene: SceneSettings) -> Photographs:
    """Which photographs of a scene are read in a run."""
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
        judged=judged_at(size),
    )


def labels(scene: SceneSettings) -> Labels:
    """Where its truth comes from."""
    return Labels(scene.labels, tuple(scene.targets), tuple(scene.categories))


def evaluation(settings: Settings, scene: SceneSettings) -> EvaluationSettings:
    """What a scene is asked in a run."""
    place = scene.options.get("scene")
    return EvaluationSettings(
        method=settings.method,
        dataset=scene.dataset,
        place=None if place is None else str(place),
        queries=tuple(scene.queries),
        rules=Rules(**settings.rules()),
    )


def chosen_baselines(names: Sequence[str]) -> dict[str, Row]:
    """The rows of the table of methods by these names, in its order.

    ``all`` stands for all that are not slow. Without our own, which is scored anyway.

    Raises
    ------
    InputError
        If there is no such method.
    """
    for name in names:
        if name not in (*ROWS, "all"):
            raise InputError(
                f"against: found {name!r}, expected all, or of these: {'; '.join(ROWS)}"
                f"{did_you_mean(name, ROWS)}"
            )
    return {
        name: row
        for name, row in ROWS.items()
        if name != OURS and (name in names or ("all" in names and not row.slow))
    }


def baseline_jobs(
    settings: Settings,
    method: Method,
    scenes: Sequence[SceneSettings],
    refs: Mapping[str, Mapping[str, ArtifactRef]],
) -> list[Job]:
    """A job for each baseline and scene, of the scenes that have ``refs`` of their stages."""
    made = []
    for scene in scenes:
        if scene.name not in refs:
            continue
        asked = evaluation(settings, scene)
        for name, row in chosen_baselines(settings.against).items():
            rules = replace(asked.rules, **row.rules)
            own = replace(asked, method=name, rules=rules, drawn=False)
            made_of = row.method, dict(row.settings), row.brought_by
            given = dict(refs[scene.name]), method, own, *made_of
            called = baseline_job_name(scene.name, name)
            made.append(Job(called, score_baseline, given, baselines.name))
    return made


def baseline_job_name(scene: str, baseline: str) -> str:
    """What the job of a baseline and scene is called, in failures too."""
    return f"{scene}: {baseline}"
