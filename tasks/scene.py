"""The stages of one scene: photographs, truth, Gaussians, label maps, bank and semantic field."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from slgaussian import datasets
from slgaussian.benchmark.annotations import Truth, label_files, read_truth
from slgaussian.benchmark.evaluate import truth_from_instances
from slgaussian.build import build_memory_bank, label_views, lift_field, predict
from slgaussian.cameras.match_graph import MatchGraph
from slgaussian.cameras.quality import Quality
from slgaussian.components.config import ComponentConfig
from slgaussian.components.method import Method
from slgaussian.copies import are_copies
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.geometry import SceneGeometry
from slgaussian.io import CHANGED_FILE, file_digest
from slgaussian.language.bank import MemoryBank
from slgaussian.predict import Depths
from slgaussian.predict.view_graph import select_usable
from slgaussian.scene import Camera, Sample
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
from tasks.stage import canonical, stage


@dataclass(frozen=True)
class Photographs:
    """Views of a scene that form a sample, and the location of their files.

    Attributes:
        scene: Name of the sample.
        format: Format of :func:`slgaussian.datasets.load`.
        path: Data of a format that reads files; identified by content.
        options: Options of the format.
        context, targets: tuple of str. Names of views.
        size, near, far, judged: Arguments of :meth:`slgaussian.scene.Scene.sample`.
    """

    scene: str
    format: str
    path: Path | None
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    context: tuple[str, ...] = ()
    targets: tuple[str, ...] = ()
    size: tuple[int, int] | str = "auto"
    near: float | None = None
    far: float | None = None
    judged: tuple[int, int] | str | None = None

    @cached_property
    def inputs(self) -> dict[str, Any]:
        """Digests of the data by :func:`data_identity`, computed once.

        Raises:
            InputError: As :meth:`read`, if the scene cannot be read or lacks a view.
        """
        return self.look()

    def look(self) -> dict[str, Any]:
        """Compute :attr:`inputs` again."""
        if self.path is None:
            return data_identity([], {}, Path())
        views = [*self.context, *self.targets]
        inputs = datasets.inputs(self.format, self.path, views, **self.options)
        return data_identity(*inputs, self.path)

    def identity(self) -> dict[str, Any]:
        """Return the identity of the sample for cache keys: content, but no locations of files."""
        names = {field.name for field in fields(self)} - {"path"}
        return {name: getattr(self, name) for name in names} | self.inputs

    def read(self) -> Sample:
        """Read the sample; InputError if it cannot be read, or a target is not held out.

        Context views whose cameras could not be estimated are left out.
        """
        paths = [] if self.path is None else [self.path]
        scene = datasets.load(self.format, *paths, **self.options)
        arguments = self.size, self.near, self.far, self.judged
        sample = scene.sample(scene.placed(self.context), self.targets, *arguments)
        sample = replace(sample, scene=self.scene)
        check_held_out(sample)
        return sample


@stage("ingest", version=15)  # increase it also when camera estimation changes
def ingest(run: RunContext, photographs: Photographs) -> ArtifactRef:
    """Read the sample of a scene: spec ``sample``.

    ``meta["cameras"]`` describes the origin of the cameras, ``meta["left_out"]`` has the reasons
    of photographs without a camera or without matches, ``meta["targets"]`` the full names of the
    targets, and ``meta["matches"]`` locates the match graph of the context views (spec
    ``matches``). InputError if the data changed meanwhile.
    """
    sample, graph, useless = select_usable(photographs.read())
    if photographs.look() != photographs.inputs:
        raise InputError(f"{photographs.path}: {CHANGED_FILE}")
    left_out = {**sample.estimation.get("left_out", {}), **useless}
    matches = run.store.put("matches", graph.to_arrays())
    meta = {
        "cameras": describe_cameras(v.camera for v in (*sample.context, *sample.targets)),
        "left_out": left_out,
        "targets": [view.name for view in sample.targets],
        "matches": {"uri": matches.uri, "digest": matches.digest},
        "parts": [matches.uri],
    }
    return run.store.put("sample", sample_to_arrays(sample), meta)


def describe_cameras(cameras: Iterable[Camera]) -> str:
    """Describe the origin of cameras: given, or estimated, with the source of focal lengths."""
    estimates = [camera.estimated for camera in cameras if camera.estimated is not None]
    if not estimates:
        return "given"
    sources = " and ".join(sorted({estimate.source for estimate in estimates}))
    return f"estimated, focal length from {sources}"


def check_held_out(sample: Sample) -> None:
    """Raise InputError if a target is a context view, or a copy of one by its content."""
    for target in sample.targets:
        for view in sample.context:
            same = "is" if target.name == view.name else "is the same picture as"
            if target.name == view.name or are_copies(target.thumbnail, view.thumbnail):
                raise InputError(
                    f"scene {sample.scene!r}: the target {target.name!r} {same} the context view "
                    f"{view.name!r}; a target must be held out"
                )


def data_identity(
    files: Iterable[Path], cameras: Mapping[str, Camera], path: Path
) -> dict[str, Any]:
    """Return the identity of data by content, for a cache key.

    Args:
        files, cameras: Results of :func:`slgaussian.datasets.inputs`.
        path: Folder or file of the data.

    Returns:
        dict: ``files``: SHA-256 by path below the folder, from :func:`digests_of`. ``cameras``:
            SHA-256 of the ordered, named cameras.
    """
    numbers = [
        (name, vars(camera) | {"K": camera.K.tolist(), "c2w": camera.c2w.tolist()})
        for name, camera in cameras.items()
    ]
    text = json.dumps(canonical(numbers), sort_keys=True)
    digests = digests_of(files, path if path.is_dir() else path.parent)
    return {"files": digests, "cameras": hashlib.sha256(text.encode()).hexdigest()}


def digests_of(files: Iterable[Path], folder: Path) -> dict[str, str]:
    """Compute the SHA-256 of files by path below a folder.

    Missing and unreadable files are skipped: their reader has a better message.
    """
    digests = {}
    for file in files:
        with suppress(OSError, ValueError):  # ValueError: invalid names
            digests[os.path.relpath(file, folder)] = file_digest(file)
    return digests


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
        return digests_of(files, self.folder)

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


@stage("geometry", version=17)
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
    if "matches" in sample.meta:
        stored = ArtifactRef("matches", **sample.meta["matches"])
        graph = MatchGraph.from_arrays(run.store.get(stored))
    else:  # a sample of a clip
        graph = MatchGraph.of(views.context)
    predicted = predict(views, graph, predictor, seed, trust_cameras)
    gaussians, geometry, quality, depths = predicted
    gaussians.check()
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
    label_maps = label_views(seen, proposer, tracker, replicas, votes)
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
    held: str,
) -> ArtifactRef:
    """Compute the code and feature vectors of every object: spec ``bank``.

    The paper's code images are ``bank.codes`` indexed by the label maps, so they are not stored.
    """
    bank = build_memory_bank(
        run.read(sample, sample_from_arrays),
        read_geometry(run, sample, gaussians),
        run.read(labels, labels_from_arrays),
        encoder,
        codes,
        seed,
        held,
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
        method,
        Quality(**gaussians.meta["quality"]),
        None if depths is None else Depths(*depths),
    )
    return put_field(run.store, joined)
