"""Judge a trained branch and its controls on lessons that it has not seen."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyarrow as pa

from slgaussian.kernels.seeding import rng_for
from slgaussian.semantic import Lifting
from slgaussian.semantic.branch import Branch, BranchLifting
from slgaussian.semantic.corruption import corrupt
from slgaussian.semantic.evaluation import label_iou
from slgaussian.semantic.hard import Filled, HardIndex
from slgaussian.semantic.lesson import Lesson
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.context import RunContext
from tasks.learning import StoredLessons, branch_from_arrays
from tasks.stage import stage

LABELS = ("as found", "corrupted")
"""What liftings are shown."""


@stage("judge", version=2)
def judge(
    run: RunContext,
    lessons: ArtifactRef,
    branch: ArtifactRef,
    before: ArtifactRef | None,
    codes: str,
    seed: int,
) -> ArtifactRef:
    """Scores of the branch, of the weights ``before`` it and of controls: spec ``judgements``."""
    store = run.store
    shown = StoredLessons(store, store.get(lessons))
    lifts = liftings(store, branch, before)
    rows: list[dict[str, Any]] = []
    for index, (clip, lesson) in enumerate(zip(shown.clips, shown, strict=True)):
        run.report(f"lesson {index + 1} of {len(shown)}")
        for kind in LABELS:
            labels = labels_of(lesson, kind, seed)
            for name, iou in label_iou(lesson, lifts, labels, codes, seed).items():
                known = None if math.isnan(iou) else iou
                row = {"sample": lesson.sample, "clip": clip, "labels": kind, "lifting": name}
                rows.append({**row, "iou": known})
    table = pa.Table.from_pylist(rows, schema=load_spec("judgements").schema)
    return store.put("judgements", table, {"lessons": len(shown)})


def liftings(
    store: ArtifactStore, branch: ArtifactRef, before: ArtifactRef | None
) -> dict[str, Lifting]:
    """A branch and, if it began from other weights, those; and the controls."""
    refs = {"before": before, "branch": branch}
    trained = {
        name: branch_from_arrays(store.get(ref)) for name, ref in refs.items() if ref is not None
    }
    untrained = Branch(trained["branch"].architecture)
    learnt = {name: BranchLifting(branch) for name, branch in trained.items()}
    return {"hard": HardIndex(), "filled": Filled(), "identity": BranchLifting(untrained), **learnt}


def labels_of(lesson: Lesson, kind: str, seed: int) -> np.ndarray:
    """Labels of the context views of a kind of :data:`LABELS`, int32 [V, H, W]."""
    if kind == "as found":
        return lesson.labels
    return corrupt(lesson.labels, rng_for(seed, lesson.content, "corrupted"))
