"""A flow with stages of a few milliseconds, to test the orchestration and not the method."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from prefect import flow
from prefect.states import Completed, State

from flows.config import Engine
from flows.runners.batches import SceneTask, map_scenes
from flows.runners.progress import Progress
from flows.runners.task_runners import open_workers
from slgaussian.errors import InputError
from slgaussian.io import KnownFile, file_digest
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.context import RunContext
from tasks.stage import stage

SHAPE = (2, 24, 32)


@stage("storm_take", version=1)
def take(run: RunContext, file: KnownFile) -> ArtifactRef:
    """Read labels from a file; InputError if it is damaged."""
    try:
        labels = np.load(file.place, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{file.place}: cannot be read ({error})") from None
    if labels.shape != SHAPE or not np.isfinite(labels).all() or (labels < 0).any():
        raise InputError(f"{file.place}: found {labels.shape}, expected whole numbers {SHAPE}")
    return run.store.put("labels", _maps(labels))


@stage("storm_smooth", version=1)
def smooth(run: RunContext, labels_ref: ArtifactRef, times: int) -> ArtifactRef:
    """Apply a maximum filter repeatedly."""
    labels = run.store.get(labels_ref)["labels"]
    for _ in range(times):
        around = [np.roll(labels, step, axis) for step in (-1, 1) for axis in (1, 2)]
        labels = np.maximum.reduce([labels, *around])
    return run.store.put("labels", _maps(labels))


def pipeline(file: str) -> None:
    """Process a scene with two stages, of which the second reads the output of the first."""
    if not os.path.exists(file):
        raise InputError(f"{file}: is not there")
    smooth(take(KnownFile(file, file_digest(Path(file)))), 3)


@flow(name="storm", persist_result=False)
def storm(root: str, files: list[str], workers: int) -> State[dict[str, str]]:
    """Process scenes in worker processes; return the reasons of those left out."""
    scenes = [SceneTask(Path(file).stem, pipeline, (file,), take.name) for file in files]
    config = Engine(runner="processes", workers=workers)
    with open_workers(config, ArtifactStore(root)) as opened:
        outcome = map_scenes(scenes, opened, Progress(len(scenes), 2))
    return Completed(data={failure.scene: failure.reason for failure in outcome.failures})


def _maps(labels: np.ndarray) -> dict[str, np.ndarray]:
    ids = labels.astype(np.int32)
    return {"labels": ids, "margin": np.full(ids.shape, 0.5, np.float32)}
