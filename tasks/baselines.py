"""Ask another method everything the truth of one scene knows, as the field of it is asked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from slgaussian.benchmark.baselines import load_method
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.benchmark.evaluate import EvaluationSettings, evaluate
from slgaussian.benchmark.resident_memory import Peak
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


@stage("baselines", version=5)
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
    """What a baseline answers, with scores and without pictures: spec ``scene_result``.

    ``gaussians`` are those that were predicted, and ``method`` is what made the field; ``of`` is
    the baseline's name in the registry, and ``own`` are its settings. One that another package
    brings is also known by that package's content, ``brought_by``.
    """
    shown = run.read(sample, sample_from_arrays)
    found = run.read(labels, labels_from_arrays)
    known = run.read(truth, truth_from_arrays)
    asked = [text for masks in known.masks.values() for text in masks]
    inputs = Inputs(
        sample=shown,
        field=get_field(run.store, field, method.encoder.places()),
        gaussians=run.read(gaussians, Gaussians.from_arrays),
        label_maps=found,
        proposer=method.proposer.load(),
        seed=method.seed,
        settings={part.name: part.values() for part in (method.proposer, method.lifting)},
        classes=tuple(dict.fromkeys([*asked, *settings.queries])),
    )
    peak = Peak()
    begun = compiling.clock()
    with peak.watched():
        answering = load_method(of, **own)(inputs)
    prepared = compiling.clock() - begun
    result = evaluate(
        answering,
        shown,
        found,
        known,
        settings,
        peak=peak,
    )
    costs = [{**row, "prepare_seconds": prepared} for row in result.costs]
    return run.store.put("scene_result", result_to_arrays(result), {"costs": costs})
