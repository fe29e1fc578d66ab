"""The report page of a training."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from slgaussian.benchmark.training_report import Example, render_training_report
from slgaussian.semantic.judge import novel_labels
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.judge import labels_of, liftings
from tasks.learning import StoredLessons
from tasks.stage import StageCall

STAGE = "training_report"
VERSION = 2

SHOWN = "corrupted"
"""The kind of labels in the pictures: as found, liftings hardly differ to the eye."""


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``report``. Inputs: judgements, lessons (held out), branch, and before if there is one.

    Settings: codes, seed (those of the judgements), manifest.
    """
    judgements = store.get(call.inputs["judgements"])
    course = call.inputs["branch"].meta["metrics"]
    page = render_training_report(
        store.get(ArtifactRef("metrics", **course)),
        judgements,
        _examples(store, call, judgements),
        call.settings["manifest"],
    )
    return store.put("report", {"html": np.frombuffer(page.encode(), np.uint8)})


def _examples(store: ArtifactStore, call: StageCall, judgements: pa.Table) -> list[Example]:
    """The lessons of the greatest, middle and least gain over no branch."""
    ious: dict[str, dict[str, float]] = {}
    for row in judgements.to_pylist():
        own = ious.setdefault(row["sample"], {})
        if row["labels"] == SHOWN and row["iou"] is not None:
            own[row["lifting"]] = row["iou"]
    lessons = StoredLessons(store, store.get(call.inputs["lessons"]))
    places = {sample: index for index, sample in enumerate(ious)}
    known = [sample for sample, own in ious.items() if own]
    known.sort(key=lambda sample: (ious[sample]["hard"] - ious[sample]["branch"], sample))
    chosen = dict.fromkeys(known[i] for i in (0, len(known) // 2, -1)) if known else {}
    lifts = {n: lift for n, lift in liftings(store, call).items() if n in ("hard", "branch")}
    seed, made = call.settings["seed"], []
    for sample in chosen:
        lesson = lessons[places[sample]]
        shown = labels_of(lesson, SHOWN, seed)
        found = novel_labels(lesson, lifts, shown, call.settings["codes"], seed)
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
