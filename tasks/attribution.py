"""Attribution of the missed queries of one scene to the stages that caused them."""

from __future__ import annotations

import pyarrow as pa

from slgaussian.benchmark.attribution import attribute_errors
from slgaussian.benchmark.evaluate import EvaluationSettings
from slgaussian.components.method import Method
from slgaussian.gaussians import Gaussians
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import get_field, sample_from_arrays, truth_from_arrays
from tasks.context import RunContext
from tasks.stage import stage


@stage("attribution", version=6)
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
        base, views = (
            run.read(gaussians, Gaussians.from_arrays),
            run.read(sample, sample_from_arrays),
        )
        rows = attribute_errors(built_field, base, views, scene_truth, settings)
    table = pa.Table.from_pylist(rows, schema=load_spec("attribution").schema)
    misses = sum(row["lost"] is not None for row in rows)
    return run.store.put("attribution", table, {"misses": misses})
