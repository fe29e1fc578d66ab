"""Training of the semantic branch on stored lessons, evaluation on held-out ones, and report."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from slgaussian.benchmark.reports import training
from slgaussian.semantic import Lifting
from slgaussian.semantic.branch import Branch, BranchLifting, load_branch, save_branch
from slgaussian.semantic.evaluation import label_iou
from slgaussian.semantic.hard import Filled, HardIndex
from slgaussian.semantic.lesson import Lesson
from slgaussian.semantic.training import Progress, TrainingSettings
from slgaussian.semantic.training import train as train_branch
from slgaussian.storage.encoding import Arrays
from slgaussian.storage.local_copies import user_cache
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.context import RunContext
from tasks.stage import stage


class StoredLessons(Sequence[Lesson]):
    """Lessons of a table of spec ``lessons``, read from the store on access."""

    def __init__(self, store: ArtifactStore, table: pa.Table) -> None:
        self.store = store
        self.clips: list[str] = table["clip"].to_pylist()
        places = zip(table["uri"].to_pylist(), table["digest"].to_pylist(), strict=True)
        self.refs = [ArtifactRef("lesson", *place) for place in places]

    def __len__(self) -> int:
        return len(self.refs)

    def __getitem__(self, index: int) -> Lesson:  # type: ignore[override]  # no slices are asked
        return Lesson.from_arrays(self.store.get(self.refs[index]))


def branch_to_arrays(branch: Branch) -> Arrays:
    """Convert a branch to spec ``weights``."""
    return {"safetensors": np.frombuffer(save_branch(branch), np.uint8)}


def branch_from_arrays(arrays: Arrays) -> Branch:
    """Inverse of :func:`branch_to_arrays`."""
    # Written to a file first, because the loader reads safetensors metadata only from files.
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "branch.safetensors"
        file.write_bytes(arrays["safetensors"].tobytes())
        return load_branch(file)


@stage("train", version=4)
def train(
    run: RunContext,
    lessons: ArtifactRef,
    start: ArtifactRef | None,
    settings: TrainingSettings,
) -> ArtifactRef:
    """Train the semantic branch: spec ``weights``.

    ``start`` are the initial weights. An interrupted training with the same cache key is resumed
    from ``checkpoints/`` in the store or, if that is remote, in the user's cache.
    ``meta["metrics"]`` locates the metrics in the store.
    """

    def tell(progress: Progress) -> None:
        run.report(
            f"step {progress.step} of {progress.steps}, loss {progress.loss:.4f}, "
            f"{progress.rate:.1f} a second, about {progress.remaining_seconds:.0f} s left"
        )

    store = run.store
    folder = (Path(store.path) if store.local else user_cache()) / "checkpoints" / run.key
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


@stage("judge", version=4)
def judge(
    run: RunContext,
    lessons: ArtifactRef,
    branch: ArtifactRef,
    before: ArtifactRef | None,
    codes: str,
    seed: int,
) -> ArtifactRef:
    """Score the branch, the weights ``before`` it and the baselines: spec ``judgements``."""
    store = run.store
    stored = StoredLessons(store, store.get(lessons))
    refs = {"before": before, "branch": branch}
    liftings: dict[str, Lifting] = {"hard": HardIndex(), "filled": Filled()}
    for name, ref in refs.items():
        if ref is not None:
            liftings[name] = BranchLifting(branch_from_arrays(store.get(ref)))
    rows: list[dict[str, Any]] = []
    for index, (clip, lesson) in enumerate(zip(stored.clips, stored, strict=True)):
        run.report(f"lesson {index + 1} of {len(stored)}")
        for name, iou in label_iou(lesson, liftings, codes, seed).items():
            row = {"sample": lesson.sample, "clip": clip, "lifting": name}
            rows.append({**row, "iou": None if math.isnan(iou) else iou})
    table = pa.Table.from_pylist(rows, schema=load_spec("judgements").schema)
    return store.put("judgements", table, {"lessons": len(stored)})


@stage("training_report", version=9)
def training_report(
    run: RunContext,
    judgements: ArtifactRef,
    branch: ArtifactRef,
    manifest: Mapping[str, Any],
) -> ArtifactRef:
    """Write the report of a training: spec ``report``."""
    store = run.store
    metrics = store.get(ArtifactRef("metrics", **branch.meta["metrics"]))
    page = training.training_report(metrics, store.get(judgements), manifest).as_html()
    return store.put("report", {"html": np.frombuffer(page.encode(), np.uint8)})
