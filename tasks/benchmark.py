"""Ask the field of one scene everything its truth knows."""

from __future__ import annotations

from statistics import fmean
from typing import Any

from slgaussian.benchmark.evaluate import EvaluationSettings, SceneResult, evaluate
from slgaussian.benchmark.scores import GOOD
from slgaussian.components.component import Component
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import (
    get_field,
    labels_from_arrays,
    result_to_arrays,
    sample_from_arrays,
    truth_from_arrays,
)
from tasks.context import RunContext
from tasks.stage import stage


@stage("benchmark", version=10)
def benchmark(
    run: RunContext,
    sample: ArtifactRef,
    truth: ArtifactRef,
    gaussians: ArtifactRef,
    labels: ArtifactRef,
    field: ArtifactRef,
    encoder: Component,
    settings: EvaluationSettings,
) -> ArtifactRef:
    """What the field of a scene answers, with scores: spec ``scene_result``.

    ``gaussians`` are those that were predicted, a depth for every pixel. ``encoder`` is that of the
    field, and says where its files are.
    """
    asked = get_field(run.store, field, encoder.places())
    result = evaluate(
        asked,
        run.read(sample, sample_from_arrays),
        run.read(labels, labels_from_arrays),
        run.read(truth, truth_from_arrays),
        settings,
        gaussians=run.read(gaussians, Gaussians.from_arrays),
    )
    meta = {"costs": result.costs, "example": example(result, asked)}
    return run.store.put("scene_result", result_to_arrays(result), meta)


def example(result: SceneResult, field: SemanticField) -> dict[str, Any] | None:
    """What to ask a field first: ``text``, and its mean ``iou``, None if there is no truth.

    Of the queries that the truth says are answered rightly in every frame, the best; or else the
    one that scored highest without truth. Only those count that the field answers with "found" in
    its first context view, where it is asked without further ado. None if there is no such query.
    """
    asked: dict[str, list[dict[str, Any]]] = {}
    for row in result.rows:
        if row["protocol"] == result.rows[0]["protocol"] and not row["note"]:
            asked.setdefault(row["query"], []).append(row)
    if not asked:
        return None
    view = field.render(next(iter(field.cameras.values())))
    found: list[tuple[bool, float, str, float | None]] = []
    for hit in view.query_all(list(asked)):
        text, rows = hit.text, asked[hit.text]
        if not hit.found:
            continue
        ious = [row["iou"] for row in rows]
        if None in ious:
            found.append((False, rows[0]["score"], text, None))
        elif min(ious) >= GOOD and all(row["hit_mask"] for row in rows):
            found.append((True, fmean(ious), text, fmean(ious)))
    if not found:
        return None
    *_, text, iou = max(found, key=lambda one: one[:2])
    return {"text": text, "iou": iou}
