"""Find out what lost each query that the field of one scene missed."""

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


@stage("attribution", version=4)
def attribution(
    run: RunContext,
    sample: ArtifactRef,
    truth: ArtifactRef,
    gaussians: ArtifactRef,
    field: ArtifactRef,
    method: Method,
    settings: EvaluationSettings,
) -> ArtifactRef:
    """Name the stage that lost each miss: spec ``attribution``.

    ``gaussians`` are those that were predicted, and ``method`` is what made the field.
    """
    known = run.read(truth, truth_from_arrays)
    rows = []
    if any(mask.any() for masks in known.masks.values() for mask in masks.values()):
        asked = get_field(run.store, field, method.encoder.places())
        base, shown = (
            run.read(gaussians, Gaussians.from_arrays),
            run.read(sample, sample_from_arrays),
        )
        rows = attribute_errors(asked, base, shown, known, settings)
    table = pa.Table.from_pylist(rows, schema=load_spec("attribution").schema)
    misses = sum(row["lost"] is not None for row in rows)
    return run.store.put("attribution", table, {"misses": misses})
