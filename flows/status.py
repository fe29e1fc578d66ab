"""Results that a configuration has in its store, found by its own pipelines without computing."""

from __future__ import annotations

from collections.abc import Sequence

from flows.benchmark import SWEPT_STAGES, find_scenes
from flows.clip_sources import find_sources, source_tasks
from flows.config import CorpusSettings, Settings
from flows.corpus import lesson_arguments, make_lessons
from flows.runners.batches import SceneResult, look_up_scenes
from flows.scene import STAGES, baseline_tasks, scene_task
from flows.sweep import combinations, sweep_tasks
from slgaussian.storage.store import ArtifactStore
from tasks.benchmark import baselines
from tasks.chunks import packed, pairs, views
from tasks.samples import lessons, predictions
from tasks.stage import Stage


def look_up(
    config: Settings | CorpusSettings, store: ArtifactStore
) -> list[tuple[list[SceneResult], dict[str, int]]]:
    """Look up each kind of task of a run, or the lessons of a corpus.

    Baselines and settings of a sweep are looked up for complete scenes.

    Returns:
        list: For each kind the results, and the versions of the stages of its pipeline, in order.

    Raises:
        InputError: If the scenes or sources are missing, or the store does not answer.
        DamagedError: If an artifact that a pipeline reads is damaged.
    """

    def versions(stages: Sequence[Stage]) -> dict[str, int]:
        return {stage.name: stage.version for stage in stages}

    if isinstance(config, CorpusSettings):
        pipeline = make_lessons, lesson_arguments(config)
        results = look_up_scenes(source_tasks(find_sources(config.sources), *pipeline), store)
        return [(results, versions((packed, views, pairs, predictions, lessons)))]
    scenes, _ = find_scenes(config)
    ours = look_up_scenes([scene_task(config, scene) for scene in scenes], store)
    refs = {result.scene: result.refs for result in ours if result.failure is None}
    complete = [scene for scene in scenes if scene.name in refs]
    answers = look_up_scenes(baseline_tasks(config, complete, refs), store)
    tasks, refused = sweep_tasks(combinations(config), complete)
    swept = look_up_scenes(tasks, store)
    swept += [SceneResult(failure.scene, {}, failure) for failure in refused]
    kinds = (ours, STAGES), (answers, (baselines,)), (swept, STAGES[:SWEPT_STAGES])
    return [(results, versions(stages)) for results, stages in kinds]
