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

import numpy as np

from slgaussian import datasets
from slgaussian.benchmark.annotations import Truth, label_files, read_truth
from slgaussian.benchmark.evaluate import truth_from_instances
from slgaussian.build import label_views, lift_field, predict, remember
from slgaussian.cameras.match_graph import MatchGraph
from slgaussian.cameras.quality import Quality
from slgaussian.components.component import Component
from slgaussian.components.method import Method
from slgaussian.datasets import licences
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.geometry import SceneGeometry
from slgaussian.io import CHANGED, file_digest
from slgaussian.language.bank import MemoryBank
from slgaussian.predict import Depths
from slgaussian.predict.view_graph import usable
from slgaussian.scene import Camera, Sample, View
from slgaussian.storage.provenance import saying
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

COPY = 1.0
"""Grey levels between two copies of a photograph at different sizes, at most, in the mean."""


@dataclass(frozen=True)
class Photographs:
    """Which views of a scene make a sample, and where its files are.

    Attributes
    ----------
    scene : str
        What the sample is called.
    format : str
        As :func:`slgaussian.datasets.load` has it.
    path : Path, optional
        The data of a format that reads files; known by what is in them.
    options : mapping
        Those of the format.
    context, targets : tuple of str
        Names of views.
    size, near, far, judged
        As :meth:`slgaussian.scene.Scene.sample` takes them.
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
        """What is known now of the data, as :func:`known_by` has it.

        Raises
        ------
        InputError
            As :meth:`read`, if the scene cannot be read, or has no such view.
        """
        return self.look()

    def look(self) -> dict[str, Any]:
        """Look at the data again; see :attr:`inputs`."""
        if self.path is None:
            return known_by([], {}, Path())
        views = [*self.context, *self.targets]
        return known_by(*datasets.inputs(self.format, self.path, views, **self.options), self.path)

    def identity(self) -> dict[str, Any]:
        """What the sample depends on: not where the files are, but what is in them."""
        settings = {field.name: getattr(self, field.name) for field in fields(self)}
        del settings["path"]
        return settings | self.inputs

    def read(self) -> Sample:
        """The sample; InputError if it cannot be read, or a target is not held out.

        Without those of the context that could not be placed when cameras were found.
        """
        paths = [] if self.path is None else [self.path]
        scene = datasets.load(self.format, *paths, **self.options)
        context = scene.placed(self.context)
        given = self.size, self.near, self.far, self.judged
        sample = scene.sample(context, self.targets, *given)
        sample = replace(sample, scene=self.scene)
        _check_held_out(sample)
        return sample


@stage("ingest", version=10)  # to be raised too when other cameras are found in photographs
def ingest(run: RunContext, photographs: Photographs) -> ArtifactRef:
    """The sample of a scene: spec ``sample``.

    ``meta["cameras"]`` says whether its cameras were given, or found and how surely;
    ``meta["left_out"]`` which photographs could not be placed then, or show what no other shows,
    and why; ``meta["targets"]`` the full names of the targets; ``meta["matches"]`` the place of the
    graph of the context views (spec ``matches``). InputError if the data were changed
    meanwhile.
    """
    sample, graph, useless = usable(photographs.read())
    if photographs.look() != photographs.inputs:
        raise InputError(f"{photographs.path}: {CHANGED}")
    left_out = {**sample.found.get("left_out", {}), **useless}
    cameras = [view.camera for view in (*sample.context, *sample.targets)]
    targets = [view.name for view in sample.targets]
    matches = run.store.put("matches", graph.to_arrays())
    meta = {
        "cameras": told_of(cameras),
        "left_out": left_out,
        "targets": targets,
        "matches": {"uri": matches.uri, "digest": matches.digest},
        "parts": [matches.uri],
    }
    source, licence = datasets.SOURCES.get(photographs.format, ("", ""))
    if photographs.path is not None:
        licence = licence or licences.stated(photographs.path)
    with saying(source, licence):
        return run.store.put("sample", sample_to_arrays(sample), meta)


def told_of(cameras: Iterable[Camera]) -> str:
    """Whether cameras were given, or found and how surely, in words."""
    found = [camera.estimated for camera in cameras if camera.estimated is not None]
    if not found:
        return "given"
    sources = " and ".join(sorted({one.source for one in found}))
    sure = min(one.confidence for one in found)
    return f"estimated, focal length from {sources}, confidence {sure:.0%}"


def _check_held_out(sample: Sample) -> None:
    for target in sample.targets:
        for view in sample.context:
            same = "is" if target.name == view.name else "is the same picture as"
            blank = (target.image == target.image[0, 0]).all()
            if target.name == view.name or (not blank and _same_picture(target, view)):
                raise InputError(
                    f"scene {sample.scene!r}: the target {target.name!r} {same} the context view "
                    f"{view.name!r}; a target must be held out"
                )


def _same_picture(target: View, view: View) -> bool:
    """Whether two views are copies of one photograph, which may have been shrunk differently."""
    if target.image.shape == view.image.shape:
        return np.array_equal(target.image, view.image)
    alike = target.resized(*view.image.shape[:2]).image.astype(float) - view.image
    return float(np.abs(alike).mean()) < COPY


def known_by(files: Iterable[Path], cameras: Mapping[str, Camera], path: Path) -> dict[str, Any]:
    """Describe data of a scene by content, for a cache key.

    Parameters
    ----------
    files, cameras
        As :func:`slgaussian.datasets.inputs` finds them.
    path : Path
        Folder or file of the data.

    Returns
    -------
    dict
        ``files``: their SHA-256 by path below the folder, as :func:`digests_of` gives it.
        ``cameras``: one over the cameras, in order and with their names. ``licence``: as a file
        beside the data says it.
    """
    folder = path if path.is_dir() else path.parent
    numbers = [
        (name, vars(camera) | {"K": camera.K.tolist(), "c2w": camera.c2w.tolist()})
        for name, camera in cameras.items()
    ]
    text = json.dumps(canonical(numbers), sort_keys=True)
    return {
        "files": digests_of(files, folder),
        "cameras": hashlib.sha256(text.encode()).hexdigest(),
        "licence": licences.stated(path),
    }


def digests_of(files: Iterable[Path], folder: Path) -> dict[str, str]:
    """SHA-256 of every file by its path below a folder.

    Files that are missing or cannot be read are left out: reading them says so better.
    """
    digests = {}
    for file in files:
        with suppress(OSError, ValueError):  # which names from outside may raise
            digests[os.path.relpath(file, folder)] = file_digest(file)
    return digests


@dataclass(frozen=True)
class Labels:
    """The label files of some targets, and which categories are read of them.

    ``folder`` is None where truth comes from instance ids.
    """

    folder: Path | None
    targets: tuple[str, ...]
    categories: tuple[str, ...]

    def of_views(self, names: Sequence[str]) -> Labels:
        """Take full names of targets, which decide in which folder their labels are looked for."""
        return replace(self, targets=tuple(names))

    @cached_property
    def files(self) -> dict[str, str]:
        """SHA-256 of every label file, by its path below the folder."""
        if self.folder is None:
            return {}
        files = [file for target in self.targets for file in label_files(self.folder, target)]
        return digests_of(files, self.folder)

    def identity(self) -> dict[str, Any]:
        """What truth depends on: not where the files are, but what is in them."""
        drawn = self.folder is not None
        return {"categories": self.categories, "drawn": drawn, "files": self.files}

    def read(self, sample: Sample) -> Truth:
        """What should be found in the targets of a sample; InputError if labels cannot be read."""
        if self.folder is None:
            return truth_from_instances(sample)
        return read_truth(self.folder, self.categories, sample.targets)


@stage("truth", version=3)
def truth(run: RunContext, sample: ArtifactRef, labels: Labels) -> ArtifactRef:
    """What should be found in the targets: spec ``truth``."""
    shown = run.read(sample, sample_from_arrays)
    found = labels.read(shown)
    return run.store.put("truth", truth_to_arrays(found, shown))


@stage("geometry", version=11)
def geometry(
    run: RunContext,
    sample: ArtifactRef,
    predictor: Component,
    seed: int,
    trust_cameras: bool = False,
) -> ArtifactRef:
    """What the predictor makes of the context views: spec ``gaussians``.

    ``meta["quality"]`` says how good the views were, ``meta["depths"]`` how many were compared of
    how many, or None.
    """
    shown = run.read(sample, sample_from_arrays)
    if "matches" in sample.meta:
        stored = ArtifactRef("matches", **sample.meta["matches"])
        graph = MatchGraph.from_arrays(run.store.get(stored))
    else:  # of a clip
        graph = MatchGraph.of(shown.context)
    gaussians, quality, depths = predict(shown, graph, predictor, seed, trust_cameras)
    gaussians.check()
    meta = {"gaussians": len(gaussians), "quality": quality.as_json(), "depths": depths}
    return run.store.put("gaussians", gaussians.to_arrays(), meta)


def read_geometry(run: RunContext, sample: ArtifactRef, gaussians: ArtifactRef) -> SceneGeometry:
    """The context views and their surfaces; made once for all stages that ask for it.

    Scattering Gaussians into depth takes less time than inflating a stored copy.
    """

    def make() -> SceneGeometry:
        shown = run.read(sample, sample_from_arrays)
        return SceneGeometry.of(shown.context, run.read(gaussians, Gaussians.from_arrays))

    return run.once((SceneGeometry, sample.digest, gaussians.digest), make)


@stage("masks", version=7)
def masks(
    run: RunContext,
    sample: ArtifactRef,
    gaussians: ArtifactRef,
    proposer: Component,
    tracker: Component,
    replicas: int,
    votes: str,
) -> ArtifactRef:
    """Object ids that agree across the context views: spec ``labels``.

    ``meta["computed"]`` says how many copies of a view were segmented.
    """
    seen = read_geometry(run, sample, gaussians)
    label_maps = label_views(seen, proposer, tracker, replicas, votes)
    meta = {"objects": len(label_maps.ids), "computed": label_maps.computed}
    return run.store.put("labels", labels_to_arrays(label_maps), meta)


@stage("supervision", version=7)
def supervision(
    run: RunContext,
    sample: ArtifactRef,
    gaussians: ArtifactRef,
    labels: ArtifactRef,
    encoder: Component,
    codes: Component,
    seed: int,
    held: str,
) -> ArtifactRef:
    """A code and vectors of every object: spec ``bank``.

    The code images of the paper are ``bank.codes`` looked up by the label maps, so they are not
    stored again.
    """
    bank = remember(
        run.read(sample, sample_from_arrays),
        read_geometry(run, sample, gaussians),
        run.read(labels, labels_from_arrays),
        encoder,
        codes,
        seed,
        held,
    )
    return run.store.put("bank", bank.to_arrays(), {"objects": len(bank)})


@stage("field", version=8)
def field(
    run: RunContext,
    sample: ArtifactRef,
    gaussians: ArtifactRef,
    labels: ArtifactRef,
    bank: ArtifactRef,
    method: Method,
) -> ArtifactRef:
    """Gaussians, label maps and bank joined: spec ``field``."""
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
