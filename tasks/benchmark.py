"""Scores of the field of one scene and of baselines, attribution of misses, report of a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

import numpy as np
import pyarrow as pa

from slgaussian.benchmark.attribution import attribute_errors
from slgaussian.benchmark.baselines import load_method
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.benchmark.evaluate import EvaluationSettings, SceneResult, evaluate
from slgaussian.benchmark.reports.examples import Scene
from slgaussian.benchmark.reports.run_report import run_report
from slgaussian.benchmark.scores import GOOD_IOU, Rows
from slgaussian.components.config import ComponentConfig
from slgaussian.components.method import Method
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians
from slgaussian.kernels import compiling
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.artifacts import (
    decode_pictures,
    decode_pngs,
    decode_predictions,
    get_field,
    labels_from_arrays,
    result_from_arrays,
    result_to_arrays,
    sample_from_arrays,
    truth_from_arrays,
)
from tasks.context import RunContext
from tasks.stage import stage


@stage("benchmark", version=16)
def benchmark(
    run: RunContext,
    sample: ArtifactRef,
    truth: ArtifactRef,
    gaussians: ArtifactRef,
    labels: ArtifactRef,
    field: ArtifactRef,
    encoder: ComponentConfig,
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
    rows_by_query: dict[str, list[Mapping[str, Any]]] = {}
    for row in result.rows:
        if row["protocol"] == result.rows[0]["protocol"] and not row["note"]:
            rows_by_query.setdefault(row["query"], []).append(row)
    if not rows_by_query:
        return None
    view = field.render(next(iter(field.cameras.values())))
    candidates: list[tuple[bool, float, dict[str, Any]]] = []
    for hit in (hit for hit in view.query_all(list(rows_by_query)) if hit.found):
        rows = rows_by_query[hit.text]
        ious = [row["iou"] for row in rows]
        if None in ious:
            candidates.append((False, rows[0]["score"], {"text": hit.text, "iou": None}))
        elif min(ious) >= GOOD_IOU and all(row["hit_mask"] for row in rows):
            candidates.append((True, fmean(ious), {"text": hit.text, "iou": fmean(ious)}))
    return max(candidates, key=lambda candidate: candidate[:2])[2] if candidates else None


@stage("baselines", version=10)
def baselines(
    run: RunContext,
    sample: ArtifactRef,
    truth: ArtifactRef,
    gaussians: ArtifactRef,
    labels: ArtifactRef,
    field: ArtifactRef,
    method: Method,
    settings: EvaluationSettings,
    of: str,
    own: Mapping[str, Any],
    brought_by: str,
) -> ArtifactRef:
    """Answer the queries by a baseline and score them, without pictures: spec ``scene_result``.

    ``gaussians`` are the predicted ones, ``method`` is the method of the field, ``of`` is the
    baseline's name in the registry, and ``own`` are its settings. ``brought_by`` is the digest of
    the package of an external baseline.
    """
    views = run.read(sample, sample_from_arrays)
    label_maps = run.read(labels, labels_from_arrays)
    scene_truth = run.read(truth, truth_from_arrays)
    inputs = Inputs(
        sample=views,
        field=get_field(run.store, field, method.encoder.places()),
        gaussians=run.read(gaussians, Gaussians.from_arrays),
        label_maps=label_maps,
        proposer=method.proposer.load(),
        seed=method.seed,
        settings={part.name: part.values() for part in (method.proposer, method.lifting)},
    )
    begun = compiling.clock()
    answering = load_method(of, **own)(inputs)
    prepared = compiling.clock() - begun
    result = evaluate(answering, views, label_maps, scene_truth, settings)
    costs = [{**row, "prepare_seconds": prepared} for row in result.costs]
    return run.store.put("scene_result", result_to_arrays(result), {"costs": costs})


@stage("attribution", version=8)
def attribution(
    run: RunContext,
    sample: ArtifactRef,
    truth: ArtifactRef,
    gaussians: ArtifactRef,
    field: ArtifactRef,
    method: Method,
    settings: EvaluationSettings,
) -> ArtifactRef:
    """Attribute each miss to a stage: spec ``attribution``.

    ``gaussians`` are the predicted ones, ``method`` is the method of the field.
    """
    scene_truth = run.read(truth, truth_from_arrays)
    rows = []
    if any(mask.any() for masks in scene_truth.masks.values() for mask in masks.values()):
        built_field = get_field(run.store, field, method.encoder.places())
        base = run.read(gaussians, Gaussians.from_arrays)
        views = run.read(sample, sample_from_arrays)
        rows = attribute_errors(built_field, base, views, scene_truth, settings)
    table = pa.Table.from_pylist(rows, schema=load_spec("attribution").schema)
    misses = sum(row["lost"] is not None for row in rows)
    return run.store.put("attribution", table, {"misses": misses})


@dataclass(frozen=True)
class Scored:
    """Results of one scene: our answers, ground truth, attribution of misses, and the answers of
    baselines by method."""

    scene: str
    answer: ArtifactRef
    truth: ArtifactRef
    attribution: ArtifactRef
    others: Mapping[str, ArtifactRef]


@stage("report", version=16)
def report(
    run: RunContext,
    scenes: Sequence[Scored],
    manifest: Mapping[str, Any],
    failures: Sequence[Mapping[str, str]],
) -> ArtifactRef:
    """Write the report of a run: spec ``report``. Images are read one scene at a time.

    It contains no timings, so that it is reproducible.
    """
    report_scenes: list[Scene] = []

    def samples() -> Iterator[Mapping[str, Any]]:
        for scored in scenes:
            refs = [scored.answer, *scored.others.values()]
            results = [result_from_arrays(run.store.get(ref)) for ref in refs]
            report_scenes.append(_report_scene(run.store, scored, results[0]))
            yield from (row for result in results for row in result.rows)

    rows = Rows.from_rows(samples())
    lost = Rows.join((Rows(run.store.get(scored.attribution)) for scored in scenes), "attribution")
    page = run_report(report_scenes, rows, manifest, failures, lost)
    forms = {"html": page.as_html(), "markdown": page.as_markdown()}
    arrays = {name: np.frombuffer(text.encode(), np.uint8) for name, text in forms.items()}
    return run.store.put("report", arrays)


def _report_scene(store: ArtifactStore, scored: Scored, ours: SceneResult) -> Scene:
    return Scene(
        name=scored.scene,
        dataset=ours.dataset,
        metrics=ours.scene_metrics,
        pictures=lambda: decode_pngs(decode_pictures(store.get(scored.answer))),
        truth=lambda: truth_from_arrays(store.get(scored.truth)).masks,
        masks=lambda: {
            k: m.decode() for k, m in decode_predictions(store.get(scored.answer)).items()
        },
    )
