"""The report of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from slgaussian.benchmark.reports.examples import Scene
from slgaussian.benchmark.reports.run_report import run_report
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.artifacts import (
    Decoded,
    pictures_of,
    predictions_of,
    result_from_arrays,
    truth_from_arrays,
)
from tasks.context import RunContext
from tasks.stage import stage


@dataclass(frozen=True)
class Scored:
    """Results of one scene: our answers, ground truth, attribution of misses, and the answers of
    baselines by method."""

    scene: str
    answer: ArtifactRef
    truth: ArtifactRef
    attribution: ArtifactRef
    others: Mapping[str, ArtifactRef]


@stage("report", version=14)
def report(
    run: RunContext,
    scenes: Sequence[Scored],
    manifest: Mapping[str, Any],
    failures: Sequence[Mapping[str, str]],
) -> ArtifactRef:
    """Write the report of a run: spec ``report``. Images are read one scene at a time.

    It contains no timings, so that it is reproducible.
    """
    report_scenes = [_scene(run.store, scored) for scored in scenes]
    tables = [run.store.get(scored.attribution) for scored in scenes]
    lost = [row for table in tables for row in table.to_pylist()]
    page = run_report(report_scenes, manifest, failures, lost)
    forms = {"html": page.as_html(), "markdown": page.as_markdown()}
    arrays = {name: np.frombuffer(text.encode(), np.uint8) for name, text in forms.items()}
    return run.store.put("report", arrays)


def _scene(store: ArtifactStore, scored: Scored) -> Scene:
    refs = [scored.answer, *scored.others.values()]
    ours, *baselines = (result_from_arrays(store.get(ref), with_images=False) for ref in refs)

    return Scene(
        name=scored.scene,
        dataset=ours.dataset,
        rows=[row for each in (ours, *baselines) for row in each.rows],
        metrics=ours.scene_metrics,
        pictures=lambda: Decoded(pictures_of(store.get(scored.answer))),
        truth=lambda: truth_from_arrays(store.get(scored.truth)).masks,
        masks=lambda: Decoded(predictions_of(store.get(scored.answer))),
    )
