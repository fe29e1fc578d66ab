"""Train the semantic branch on lessons."""

from __future__ import annotations

import shutil
from pathlib import Path

from slgaussian.semantic.branch import Architecture
from slgaussian.semantic.training import Progress, TrainingSettings, train
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.learning import StoredLessons, branch_from_arrays, branch_to_arrays
from tasks.stage import StageCall, tell

STAGE = "train"
VERSION = 2


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``weights``. Settings: those of a training. Inputs: lessons, and start if there is one.

    ``where["checkpoints"]`` is a local folder in which an interrupted training of this very key
    goes on. ``meta["metrics"]`` is the place of the metrics in the store.
    """
    given = call.settings["architecture"]
    architecture = Architecture(**{**given, "widths": tuple(given["widths"])})
    settings = TrainingSettings(**{**call.settings, "architecture": architecture})
    start = call.inputs.get("start")
    folder = Path(call.where["checkpoints"]) / call.key
    trained = train(
        StoredLessons(store, store.get(call.inputs["lessons"])),
        settings,
        folder,
        None if start is None else branch_from_arrays(store.get(start)),
        _tell,
    )
    metrics = store.put("metrics", trained.metrics)
    meta = {"metrics": {"uri": metrics.uri, "digest": metrics.digest}, "parts": [metrics.uri]}
    ref = store.put("weights", branch_to_arrays(trained.branch), meta)
    shutil.rmtree(folder)
    return ref


def _tell(progress: Progress) -> None:
    tell(
        f"step {progress.step} of {progress.steps}, loss {progress.loss:.4f}, "
        f"{progress.rate:.1f} a second, about {progress.seconds_left:.0f} s left"
    )
