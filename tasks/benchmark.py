"""Ask the field of one scene everything its truth knows."""

from __future__ import annotations

from statistics import fmean
from typing import Any

import numpy as np

from slgaussian.benchmark.evaluate import EvaluationSettings, SceneResult, evaluate
from slgaussian.benchmark.showcase import MISS
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians
from slgaussian.language.query import Rules
from slgaussian.parts.part import Part
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import (
    get_field,
    labels_from_arrays,
    result_to_arrays,
    sample_from_arrays,
    truth_from_arrays,
)
from tasks.stage import Worksite, stage


@stage("benchmark", version=9)
def benchmark(
    site: Worksite,
    sample: ArtifactRef,
    truth: ArtifactRef,
    gaussians: ArtifactRef,
    labels: ArtifactRef,
    field: ArtifactRef,
    encoder: Part,
    settings: EvaluationSettings,
) -> ArtifactRef:
    """What the field of a scene answers, with scores: spec ``scene_result``.

    ``gaussians`` are those that were predicted, a depth for every pixel. ``encoder`` is that of the
    field, and says where its files are.
    """
    asked = get_field(site.store, field, encoder.places())
    result = evaluate(
        asked,
        site.read(sample, sample_from_arrays),
        site.read(labels, labels_from_arrays),
        site.read(truth, truth_from_arrays),
        settings,
        gaussians=site.read(gaussians, Gaussians.from_arrays),
    )
    meta = {"times": result.times, "costs": result.costs, "example": example(result, asked)}
    return site.store.put("scene_result", result_to_arrays(result), meta)


def example(result: SceneResult, field: SemanticField) -> dict[str, Any] | None:
    """What to ask a field first: ``text``, and its mean ``iou``, None if there is no truth.

    Of the queries that the truth says are answered rightly in every frame, the best; or else the
    one that scored highest without truth. Only those count for which the first context view, where
    it is asked without further ado, holds an object that fits about as well as any. None if there
    is no such query.
    """
    rules = Rules()
    asked: dict[str, list[dict[str, Any]]] = {}
    for row in result.rows:
        if row["protocol"] == result.rows[0]["protocol"] and not row["note"]:
            asked.setdefault(row["query"], []).append(row)
    found: list[tuple[bool, float, str, float | None]] = []
    for text, rows in asked.items():
        (gaps,) = field.reader.gaps([text], rules)
        here = gaps[field.bank.present[:, 0]].max(initial=-np.inf)
        if here <= 0 or here < rules.share * gaps.max():
            continue
        ious = [row["iou"] for row in rows]
        if None in ious:
            found.append((False, rows[0]["score"], text, None))
        elif min(ious) >= MISS and all(row["hit_mask"] for row in rows):
            found.append((True, fmean(ious), text, fmean(ious)))
    if not found:
        return None
    *_, text, iou = max(found, key=lambda one: one[:2])
    return {"text": text, "iou": iou}
