"""Numerical errors of hard cases on the worker's machine, once for each kind and version."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

import pyarrow as pa

from slgaussian.benchmark.hard_cases import measure_hard_cases
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef
from tasks.context import RunContext
from tasks.stage import stage


@stage("numerics", version=3)
def numerics(run: RunContext, machine: Mapping[str, str]) -> ArtifactRef:
    """Measure the float32 errors of hard cases: spec ``hard_cases``.

    ``machine`` identifies processor, libraries and kernels, which determine the last digits.
    """
    rows = [asdict(case) for case in measure_hard_cases()]
    return run.store.put(
        "hard_cases", pa.Table.from_pylist(rows, schema=load_spec("hard_cases").schema)
    )
