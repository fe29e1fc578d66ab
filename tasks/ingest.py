"""Read the photographs and cameras of one scene into the store, once."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian import datasets
from slgaussian.datasets import licences
from slgaussian.errors import InputError
from slgaussian.predict.links import usable
from slgaussian.scene import Camera, Sample, View
from slgaussian.storage.provenance import saying
from slgaussian.storage.store import ArtifactRef, sha256_of
from tasks.artifacts import sample_to_arrays
from tasks.stage import Worksite, stage

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
    options: Mapping[str, Any] = field(default_factory=dict)
    context: tuple[str, ...] = ()
    targets: tuple[str, ...] = ()
    size: tuple[int, int] | str = "auto"
    near: float | None = None
    far: float | None = None
    judged: tuple[int, int] | str | None = None

    @cached_property
    def files(self) -> dict[str, str]:
        """SHA-256 of every file that the views are read from, by its path below ``path``.

        What is missing or unreadable is left out: reading the scene says so better.
        """
        if self.path is None:
            return {}
        folder = self.path if self.path.is_dir() else self.path.parent
        views = [*self.context, *self.targets]
        try:
            files = datasets.files(self.format, self.path, views, **self.options)
        except InputError:
            return {}
        return digests_of(files, folder)

    def identity(self) -> dict[str, Any]:
        """What the sample depends on: not where the files are, but what is in them."""
        return {name: value for name, value in vars(self).items() if name != "path"} | {
            "files": self.files
        }

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


@stage("ingest", version=7)  # to be raised too when other cameras are found in photographs
def ingest(site: Worksite, photographs: Photographs) -> ArtifactRef:
    """The sample of a scene: spec ``sample``.

    ``meta["cameras"]`` says whether its cameras were given, or found and how surely;
    ``meta["left_out"]`` which photographs could not be placed then, or show what no other shows,
    and why.
    """
    sample, useless = usable(photographs.read())
    left_out = {**sample.found.get("left_out", {}), **useless}
    cameras = [view.camera for view in (*sample.context, *sample.targets)]
    meta = {"cameras": told_of(cameras), "left_out": left_out}
    source, licence = datasets.SOURCES.get(photographs.format, ("", ""))
    if photographs.path is not None:
        licence = licence or licences.stated(photographs.path)
    with saying(source, licence):
        return site.store.put("sample", sample_to_arrays(sample), meta)


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


def digests_of(files: Iterable[Path], folder: Path) -> dict[str, str]:
    """SHA-256 of every file that is there, by its path below a folder."""
    there = [file for file in files if file.is_file()]
    return {
        os.path.relpath(file, folder): _digest(file, file.stat().st_mtime_ns, file.stat().st_size)
        for file in there
    }


@lru_cache(maxsize=1024)
def _digest(file: Path, changed: int, size: int) -> str:
    """SHA-256 of a file that many scenes may share, as a chunk or a model."""
    return sha256_of(file)
