"""Evaluation of a baseline on one scene, with the queries of our method."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from slgaussian.benchmark.baselines import load_method
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.benchmark.evaluate import EvaluationSettings, evaluate
from slgaussian.components.method import Method
from slgaussian.gaussians import Gaussians
from slgaussian.kernels import compiling
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


@stage("baselines", version=7)
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
    texts = [text for masks in scene_truth.masks.values() for text in masks]
    inputs = Inputs(
        sample=views,
        field=get_field(run.store, field, method.encoder.places()),
        gaussians=run.read(gaussians, Gaussians.from_arrays),
        label_maps=label_maps,
        proposer=method.proposer.load(),
        seed=method.seed,
        settings={part.name: part.values() for part in (method.proposer, method.lifting)},
        classes=tuple(dict.fromkeys([*texts, *settings.queries])),
    )
    begun = compiling.clock()
    answering = load_method(of, **own)(inputs)
    prepared = compiling.clock() - begun
    result = evaluate(answering, views, label_maps, scene_truth, settings)
    costs = [{**row, "prepare_seconds": prepared} for row in result.costs]
    return run.store.put("scene_result", result_to_arrays(result), {"costs": costs})
