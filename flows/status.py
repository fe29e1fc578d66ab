"""Results that a configuration has in its store, found by its own pipelines without computing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from flows.benchmark import SWEPT_STAGES, scenes_of
from flows.clip_sources import source_tasks, sources_of
from flows.config import CorpusSettings, Settings
from flows.corpus import lesson_arguments, make_lessons
from flows.runners.batches import FAILURES, SceneResult, look_up_scenes
from flows.scene import STAGES, baseline_tasks, scene_task
from flows.sweep import combinations, sweep_tasks
from slgaussian.storage.backlog import Walk, read_failures, walk_scene
from slgaussian.storage.store import ArtifactStore
from tasks.benchmark import baselines
from tasks.chunks import packed, pairs, views
from tasks.samples import lessons, predictions
from tasks.stage import Stage


def walk_scenes(config: Settings | CorpusSettings, store: ArtifactStore) -> Iterator[Walk]:
    """Yield the walk of each scene, and of the baselines and settings on complete scenes.

    A gap that the last run reported in its output folder is a failure.

    Raises:
        InputError: If the scenes or sources are missing, or the store does not answer.
        SpecError: If the table of failures, or an artifact that is read, is damaged.
    """
    reported = read_failures(config.out / FAILURES)
    for results, stages in _look_up(config, store):
        versions = {stage.name: stage.version for stage in stages}
        for result in results:
            failure = result.failure
            gap = None if failure is None else (failure.stage, failure.kind, failure.reason)
            yield walk_scene(result.scene, versions, result.refs, gap, reported)


def _look_up(
    config: Settings | CorpusSettings, store: ArtifactStore
) -> list[tuple[list[SceneResult], Sequence[Stage]]]:
    """Return the results of each kind of task, with the stages of its pipeline."""
    if isinstance(config, CorpusSettings):
        pipeline = make_lessons, lesson_arguments(config)
        tasks = source_tasks(sources_of(config.sources), *pipeline)
        return [(look_up_scenes(tasks, store), (packed, views, pairs, predictions, lessons))]
    scenes, _ = scenes_of(config)
    ours = look_up_scenes([scene_task(config, scene) for scene in scenes], store)
    refs = {result.scene: result.refs for result in ours if result.failure is None}
    complete = [scene for scene in scenes if scene.name in refs]
    answers = look_up_scenes(baseline_tasks(config, complete, refs), store)
    tasks, refused = sweep_tasks(combinations(config), complete)
    swept = look_up_scenes(tasks, store)
    swept += [SceneResult(failure.scene, {}, failure) for failure in refused]
    return [(ours, STAGES), (answers, (baselines,)), (swept, STAGES[:SWEPT_STAGES])]
