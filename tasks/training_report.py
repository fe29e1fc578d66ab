"""The report page of a training."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from slgaussian.benchmark.reports import training
from slgaussian.benchmark.reports.training import Example
from slgaussian.semantic import Lifting
from slgaussian.semantic.evaluation import novel_labels
from slgaussian.storage.store import ArtifactRef
from tasks.context import RunContext
from tasks.judge import labels_of, liftings
from tasks.learning import StoredLessons
from tasks.stage import stage

SHOWN = "corrupted"
"""The kind of labels in the pictures: as found, liftings hardly differ to the eye."""


@stage("training_report", version=3)
def training_report(
    run: RunContext,
    judgements: ArtifactRef,
    lessons: ArtifactRef,
    branch: ArtifactRef,
    codes: str,
    seed: int,
    manifest: Mapping[str, Any],
) -> ArtifactRef:
    """The page of a training: spec ``report``.

    ``lessons`` are those held out, and ``codes`` and ``seed`` those of the judgements.
    """
    store = run.store
    rows = store.get(judgements)
    held_out = StoredLessons(store, store.get(lessons))
    page = training.training_report(
        store.get(ArtifactRef("metrics", **branch.meta["metrics"])),
        rows,
        _examples(held_out, liftings(store, branch, None), rows, codes, seed),
        manifest,
    ).as_html()
    return store.put("report", {"html": np.frombuffer(page.encode(), np.uint8)})


def _examples(
    lessons: StoredLessons,
    lifts: Mapping[str, Lifting],
    judgements: pa.Table,
    codes: str,
    seed: int,
) -> list[Example]:
    """The lessons of the greatest, middle and least gain over no branch."""
    ious: dict[str, dict[str, float]] = {}
    for row in judgements.to_pylist():
        own = ious.setdefault(row["sample"], {})
        if row["labels"] == SHOWN and row["iou"] is not None:
            own[row["lifting"]] = row["iou"]
    places = {sample: index for index, sample in enumerate(ious)}
    known = [sample for sample, own in ious.items() if own]
    known.sort(key=lambda sample: (ious[sample]["hard"] - ious[sample]["branch"], sample))
    chosen = dict.fromkeys(known[i] for i in (0, len(known) // 2, -1)) if known else {}
    lifts = {name: lift for name, lift in lifts.items() if name in ("hard", "branch")}
    made = []
    for sample in chosen:
        lesson = lessons[places[sample]]
        shown = labels_of(lesson, SHOWN, seed)
        found = novel_labels(lesson, lifts, shown, codes, seed)
        middle = len(lesson.targets) // 2
        made.append(
            Example(
                sample,
                SHOWN,
                shown[0],
                lesson.targets[middle],
                {name: views[middle] for name, views in found.items()},
                ious[sample],
            )
        )
    return made
