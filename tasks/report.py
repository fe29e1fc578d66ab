"""The report page of a run."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from slgaussian.benchmark.report import write_report
from slgaussian.store import ArtifactRef, ArtifactStore
from tasks.artifacts import result_from_arrays
from tasks.stage import StageCall

STAGE = "report"
VERSION = 1


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``report``. Settings: scenes (their order), manifest, failures. Inputs: one result each.

    Times shown are those of when each result was made: they travel in the refs' ``meta``, and
    ``where`` names the machine, so neither decides whether the page is made again.
    """
    results = [
        result_from_arrays(store.get(call.inputs[scene]), call.inputs[scene].meta["times"])
        for scene in call.settings["scenes"]
    ]
    stages: dict[str, float] = {}
    for ref in call.inputs.values():
        for stage, seconds in ref.meta["stages"].items():
            stages[stage] = stages.get(stage, 0.0) + seconds
    manifest = {**call.settings["manifest"], "host": dict(call.where)}
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "report.html"
        write_report(results, manifest, page, stages, call.settings["failures"])
        return store.put("report", {"html": np.frombuffer(page.read_bytes(), np.uint8)})
