"""The stages of one scene: photographs, truth, Gaussians, label maps, bank and semantic field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from slgaussian.benchmark.annotations import Truth, label_files, read_truth
from slgaussian.benchmark.evaluate import truth_from_instances
from slgaussian.build import build_memory_bank, label_views, lift_field, predict, select_usable
from slgaussian.cameras.estimated import describe_cameras
from slgaussian.cameras.match_graph import MatchGraph, match_views
from slgaussian.cameras.quality import Quality
from slgaussian.components.config import ComponentConfig
from slgaussian.components.method import Method
from slgaussian.datasets.sources import Photographs, hash_files
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.geometry import SceneGeometry
from slgaussian.io import CHANGED_FILE
from slgaussian.language.bank import MemoryBank
from slgaussian.predict import Depths
from slgaussian.scene import Sample
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import (
    labels_from_arrays,
    labels_to_arrays,
    put_field,
    sample_from_arrays,
    sample_to_arrays,
    truth_to_arrays,
)
from tasks.context import RunContext
from tasks.stage import stage


@stage("ingest", version=16)  # increase it also when camera estimation changes
def ingest(run: RunContext, photographs: Photographs) -> ArtifactRef:
    """Read the sample of a scene: spec ``sample``.

    ``meta["cameras"]`` describes the origin of the cameras, ``meta["left_out"]`` has the reasons
    of photographs without a camera or without matches, ``meta["targets"]`` the full names of the
    targets, and ``meta["matches"]`` locates the match graph of the context views (spec
    ``matches``). InputError if the data changed meanwhile.
    """
    sample, useless = select_usable(photographs.read())
    if photographs.look() != photographs.inputs:
        raise InputError(f"{photographs.path}: {CHANGED_FILE}")
    matches = run.store.put("matches", match_views(sample).to_arrays())
    meta = {
        "cameras": describe_cameras(v.camera for v in (*sample.context, *sample.targets)),
        "left_out": {**sample.estimation.get("left_out", {}), **useless},
        "targets": [view.name for view in sample.targets],
        "matches": {"uri": matches.uri, "digest": matches.digest},
        "parts": [matches.uri],
    }
    return run.store.put("sample", sample_to_arrays(sample), meta)


@dataclass(frozen=True)
class Labels:
    """Label files of targets, and the categories to read.

    ``folder`` is None if ground truth comes from instance ids.
    """

    folder: Path | None
    targets: tuple[str, ...]
    categories: tuple[str, ...]

    def of_views(self, names: Sequence[str]) -> Labels:
        """Replace the targets by their full names, which determine the folders of label files."""
        return replace(self, targets=tuple(names))

    @cached_property
    def files(self) -> dict[str, str]:
        """SHA-256 of every label file, by its path below the folder."""
        if self.folder is None:
            return {}
        files = [file for target in self.targets for file in label_files(self.folder, target)]
        return hash_files(files, self.folder)

    def identity(self) -> dict[str, Any]:
        """Return the identity of the truth for cache keys: content, but no locations of files."""
        drawn = self.folder is not None
        return {"categories": self.categories, "drawn": drawn, "files": self.files}

    def read(self, sample: Sample) -> Truth:
        """Read the ground truth of the targets; InputError if labels cannot be read."""
        if self.folder is None:
            return truth_from_instances(sample)
        return read_truth(self.folder, self.categories, sample.targets)


@stage("truth", version=4)
def truth(run: RunContext, sample: ArtifactRef, labels: Labels) -> ArtifactRef:
    """Read the ground truth of the targets: spec ``truth``."""
    views = run.read(sample, sample_from_arrays)
    scene_truth = labels.read(views)
    return run.store.put("truth", truth_to_arrays(scene_truth, views))


@stage("geometry", version=18)
def geometry(
    run: RunContext,
    sample: ArtifactRef,
    predictor: ComponentConfig,
    seed: int,
    trust_cameras: bool = False,
) -> ArtifactRef:
    """Predict Gaussians from the context views: spec ``gaussians``.

    ``meta["quality"]`` has the quality of the views, ``meta["depths"]`` the numbers of compared and
    possible depths, or None.
    """
    views = run.read(sample, sample_from_arrays)
    if "matches" in sample.meta:  # not in those of clips
        stored = run.store.get(ArtifactRef("matches", **sample.meta["matches"]))
        views = replace(views, matches=MatchGraph.from_arrays(stored))
    gaussians, geometry, quality, depths = predict(views, predictor.load(), seed, trust_cameras)
    meta = {"gaussians": len(gaussians), "quality": quality.as_json(), "depths": depths}
    ref = run.store.put("gaussians", gaussians.to_arrays(), meta)
    run.once((SceneGeometry, sample.digest, ref.digest), lambda: geometry)
    return ref


def read_geometry(run: RunContext, sample: ArtifactRef, gaussians: ArtifactRef) -> SceneGeometry:
    """Compute the geometry of the context views once for all stages.

    Scattering Gaussians into depth is faster than decompressing a stored copy.
    """
    views = run.read(sample, sample_from_arrays)
    predicted = run.read(gaussians, Gaussians.from_arrays)
    key = SceneGeometry, sample.digest, gaussians.digest
    return run.once(key, lambda: SceneGeometry.of(views.context, predicted))


@stage("masks", version=8)
def masks(
    run: RunContext,
    sample: ArtifactRef,
    gaussians: ArtifactRef,
    proposer: ComponentConfig,
    tracker: ComponentConfig,
    replicas: int,
    votes: str,
) -> ArtifactRef:
    """Label the context views with consistent object ids: spec ``labels``.

    ``meta["computed"]`` is the number of segmented copies of a view.
    """
    seen = read_geometry(run, sample, gaussians)
    label_maps = label_views(seen, proposer.load(), tracker.load(), replicas, votes)
    meta = {"objects": len(label_maps.ids), "computed": label_maps.computed}
    return run.store.put("labels", labels_to_arrays(label_maps), meta)


@stage("supervision", version=8)
def supervision(
    run: RunContext,
    sample: ArtifactRef,
    gaussians: ArtifactRef,
    labels: ArtifactRef,
    encoder: ComponentConfig,
    codes: ComponentConfig,
    seed: int,
    entries: str,
) -> ArtifactRef:
    """Compute the code and feature vectors of every object: spec ``bank``.

    The paper's code images are ``bank.codes`` indexed by the label maps, so they are not stored.
    """
    bank = build_memory_bank(
        run.read(sample, sample_from_arrays),
        read_geometry(run, sample, gaussians),
        run.read(labels, labels_from_arrays),
        encoder.load(),
        codes.load(),
        seed,
        entries,
    )
    return run.store.put("bank", bank.to_arrays(), {"objects": len(bank)})


@stage("field", version=11)
def field(
    run: RunContext,
    sample: ArtifactRef,
    gaussians: ArtifactRef,
    labels: ArtifactRef,
    bank: ArtifactRef,
    method: Method,
) -> ArtifactRef:
    """Combine Gaussians, label maps and bank: spec ``field``."""
    depths = gaussians.meta["depths"]
    joined = lift_field(
        run.read(sample, sample_from_arrays),
        run.read(gaussians, Gaussians.from_arrays),
        replace(run.read(labels, labels_from_arrays), computed=labels.meta["computed"]),
        run.read(bank, MemoryBank.from_arrays),
        method.lifting.load(),
        method,
        Quality(**gaussians.meta["quality"]),
        None if depths is None else Depths(*depths),
    )
    return put_field(run.store, joined)
