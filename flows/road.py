"""The road of a scene, from photographs to scores: each line a stage, in the order that they run.

A stage is a Prefect task whose result is looked up in the store first (:mod:`tasks.stage`).
:func:`slgaussian.build.build_field` takes the same road with arrays in memory and without a store,
from a sample to a field. Who walks it, and on how many scenes at a time, stands in
:mod:`flows.runners`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from slgaussian.benchmark.evaluate import EvaluationSettings
from slgaussian.kernels import threads
from slgaussian.parts.method import Method
from slgaussian.storage.store import ArtifactRef
from tasks.attribution import attribution
from tasks.baselines import baselines
from tasks.benchmark import benchmark
from tasks.field import field
from tasks.geometry import geometry
from tasks.ingest import Photographs, ingest
from tasks.masks import masks
from tasks.numerics import numerics
from tasks.supervision import supervision
from tasks.truth import Labels, truth

STAGES = (ingest, truth, geometry, masks, supervision, field, benchmark, attribution)
"""The stages of :func:`score_scene`, in their order."""


def score_scene(
    photographs: Photographs,
    labels: Labels,
    method: Method,
    trust_cameras: bool,
    settings: EvaluationSettings,
) -> None:
    """Build the field of a scene, ask it all that its truth knows, and find what lost each miss."""
    made = answer_scene(photographs, labels, method, trust_cameras, settings)
    # What is asked without truth can be no miss.
    attribution(*made, method, replace(settings, queries=()))


def answer_scene(
    photographs: Photographs,
    labels: Labels,
    method: Method,
    trust_cameras: bool,
    settings: EvaluationSettings,
) -> tuple[ArtifactRef, ArtifactRef, ArtifactRef, ArtifactRef, ArtifactRef]:
    """Build the field of a scene and ask it: sample, truth, Gaussians, label maps and field."""
    sample = ingest(photographs)
    known = truth(sample, labels.of_views(sample.meta["targets"]))
    base = geometry(sample, method.predictor, method.seed, trust_cameras)
    ids = masks(sample, base, method.proposer, method.tracker, method.replicas)
    bank = supervision(sample, base, ids, method.encoder, method.codes, method.seed, method.bank)
    built = field(sample, base, ids, bank, method)
    benchmark(sample, known, base, ids, built, method.encoder, settings)
    return sample, known, base, ids, built


def score_baseline(
    refs: Mapping[str, ArtifactRef],
    method: Method,
    settings: EvaluationSettings,
    name: str,
    own: Mapping[str, Any],
    brought_by: str,
) -> None:
    """Ask the baseline of a name, with settings of its own, what the field of a scene was asked.

    ``refs`` are what the stages of :func:`score_scene` made of the scene.
    """
    made = (refs[stage] for stage in ("ingest", "truth", "geometry", "masks", "field"))
    baselines(*made, method, settings, name, own, brought_by)


def check_numerics() -> None:
    """Measure the hard cases of the machine that works, unless it or one of its kind has."""
    known = {"processor_name": threads.processor(), "code": threads.kernel_folder().name}
    numerics(threads.kernels() | known)
