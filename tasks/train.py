"""Train the semantic branch on lessons."""

from __future__ import annotations

import shutil
from pathlib import Path

from slgaussian.semantic.training import Progress
from slgaussian.semantic.training import train as train_branch
from slgaussian.semantic.training_settings import TrainingSettings
from slgaussian.storage.store import ArtifactRef
from tasks.context import RunContext
from tasks.learning import StoredLessons, branch_from_arrays, branch_to_arrays
from tasks.stage import stage


@stage("train", version=2, unkeyed=("checkpoints",))
def train(
    run: RunContext,
    lessons: ArtifactRef,
    start: ArtifactRef | None,
    settings: TrainingSettings,
    checkpoints: Path,
) -> ArtifactRef:
    """Weights of the semantic branch: spec ``weights``.

    ``start`` are weights to begin from. ``checkpoints`` is a local folder in which an interrupted
    training of this very key goes on.
    ``meta["metrics"]`` is the place of the metrics in the store.
    """

    def tell(progress: Progress) -> None:
        run.report(
            f"step {progress.step} of {progress.steps}, loss {progress.loss:.4f}, "
            f"{progress.rate:.1f} a second, about {progress.seconds_left:.0f} s left"
        )

    store = run.store
    folder = checkpoints / run.key
    trained = train_branch(
        StoredLessons(store, store.get(lessons)),
        settings,
        folder,
        None if start is None else branch_from_arrays(store.get(start)),
        tell,
    )
    metrics = store.put("metrics", trained.metrics)
    meta = {"metrics": {"uri": metrics.uri, "digest": metrics.digest}, "parts": [metrics.uri]}
    ref = store.put("weights", branch_to_arrays(trained.branch), meta)
    shutil.rmtree(folder)
    return ref
