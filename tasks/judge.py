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
from slgaussian.semantic.filled import Filled
from slgaussian.semantic.hard import HardIndex
from slgaussian.semantic.judge import label_iou
from slgaussian.semantic.lesson import Lesson
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.learning import StoredLessons, branch_from_arrays
from tasks.stage import StageCall, tell

STAGE = "judge"
VERSION = 2

LABELS = ("as found", "corrupted")
"""What liftings are shown."""


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``judgements``. Settings: codes, seed. Inputs: lessons, branch, and before if any."""
    lessons = StoredLessons(store, store.get(call.inputs["lessons"]))
    lifts = liftings(store, call)
    asked = {"codes": call.settings["codes"], "seed": call.settings["seed"]}
    rows: list[dict[str, Any]] = []
    for index, (clip, lesson) in enumerate(zip(lessons.clips, lessons, strict=True)):
        tell(f"lesson {index + 1} of {len(lessons)}")
        for kind in LABELS:
            shown = labels_of(lesson, kind, call.settings["seed"])
            for name, iou in label_iou(lesson, lifts, shown, **asked).items():
                known = None if math.isnan(iou) else iou
                row = {"sample": lesson.sample, "clip": clip, "labels": kind, "lifting": name}
                rows.append({**row, "iou": known})
    table = pa.Table.from_pylist(rows, schema=load_spec("judgements").schema)
    return store.put("judgements", table, {"lessons": len(lessons)})


def liftings(store: ArtifactStore, call: StageCall) -> dict[str, Lifting]:
    """The branch of a call and, if it began from other weights, those; and the controls."""
    trained = {
        name: branch_from_arrays(store.get(call.inputs[name]))
        for name in ("before", "branch")
        if name in call.inputs
    }
    untrained = Branch(trained["branch"].architecture)
    learnt = {name: BranchLifting(branch) for name, branch in trained.items()}
    return {"hard": HardIndex(), "filled": Filled(), "identity": BranchLifting(untrained), **learnt}


def labels_of(lesson: Lesson, kind: str, seed: int) -> np.ndarray:
    """Labels of the context views of a kind of :data:`LABELS`, int32 [V, H, W]."""
    if kind == "as found":
        return lesson.labels
    return corrupt(lesson.labels, rng_for(seed, lesson.content, "corrupted"))
