"""Evaluation of the field of one scene on the queries of its ground truth."""

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


@stage("benchmark", version=13)
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
    """Answer the queries by the field of a scene and score them: spec ``scene_result``.

    ``gaussians`` are the predicted ones, with a depth for every pixel. ``encoder`` is the encoder
    of the field, with the locations of its files.
    """
    built_field = get_field(run.store, field, encoder.places())
    result = evaluate(
        built_field,
        run.read(sample, sample_from_arrays),
        run.read(labels, labels_from_arrays),
        run.read(truth, truth_from_arrays),
        settings,
        gaussians=run.read(gaussians, Gaussians.from_arrays),
    )
    meta = {"costs": result.costs, "example": example(result, built_field)}
    return run.store.put("scene_result", result_to_arrays(result), meta)


def example(result: SceneResult, field: SemanticField) -> dict[str, Any] | None:
    """Choose an example query: ``text``, and its mean ``iou``, None without ground truth.

    The best query among those with correct answers in every frame, else the highest score without
    ground truth. The field must answer it with "found" in its first context view, the default view
    of queries. None if there is no such query.
    """
    rows_by_query: dict[str, list[dict[str, Any]]] = {}
    for row in result.rows:
        if row["protocol"] == result.rows[0]["protocol"] and not row["note"]:
            rows_by_query.setdefault(row["query"], []).append(row)
    if not rows_by_query:
        return None
    view = field.render(next(iter(field.cameras.values())))
    candidates: list[tuple[bool, float, str, float | None]] = []
    for hit in view.query_all(list(rows_by_query)):
        text, rows = hit.text, rows_by_query[hit.text]
        if not hit.found:
            continue
        ious = [row["iou"] for row in rows]
        if None in ious:
            candidates.append((False, rows[0]["score"], text, None))
        elif min(ious) >= GOOD and all(row["hit_mask"] for row in rows):
            candidates.append((True, fmean(ious), text, fmean(ious)))
    if not candidates:
        return None
    *_, text, iou = max(candidates, key=lambda candidate: candidate[:2])
    return {"text": text, "iou": iou}
