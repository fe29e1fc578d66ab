"""The report page of a run."""

from __future__ import annotations

import numpy as np

from slgaussian.benchmark.report import render_report
from slgaussian.store import ArtifactRef, ArtifactStore
from tasks.artifacts import result_from_arrays
from tasks.stage import StageCall

STAGE = "report"
VERSION = 2


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``report``. Settings: answers (their order), manifest, failures.

    Inputs: one result each.

    The page has no times in it: it is the same whenever and wherever it is made.
    """
    results = [
        result_from_arrays(store.get(call.inputs[name]), times={})
        for name in call.settings["answers"]
    ]
    page = render_report(results, call.settings["manifest"], call.settings["failures"])
    return store.put("report", {"html": np.frombuffer(page.encode(), np.uint8)})
