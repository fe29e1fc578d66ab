"""Data that stages read: photographs, folders, rooms, identified by content in cache keys."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from slgaussian import datasets
from slgaussian.datasets.recognise import posed_scene, recognise
from slgaussian.io import file_digest
from slgaussian.scene import Camera, Sample, Scene


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
    options: Mapping[str, Any] = field(default_factory=dict)
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
        names = {item.name for item in fields(self)} - {"path"}
        return {name: getattr(self, name) for name in names} | self.inputs

    def read(self) -> Sample:
        """Read the sample; InputError if it cannot be read, or a target is not held out.

        Context views whose cameras could not be estimated are left out.
        """
        paths = [] if self.path is None else [self.path]
        scene = datasets.load(self.format, *paths, **self.options)
        arguments = self.size, self.near, self.far, self.judged
        sample = scene.sample(scene.with_cameras(self.context), self.targets, *arguments)
        sample = replace(sample, scene=self.scene)
        sample.check_held_out()
        return sample


@dataclass(frozen=True)
class PosedFolder:
    """A folder or file with the cameras of one scene, or with photographs alone.

    Attributes:
        name: Name of its clip.
    """

    name: str
    path: Path

    def identity(self) -> dict[str, Any]:
        """Return the identity for cache keys: the name, and digests of the files."""
        format, place = recognise(self.path)
        if format == "photographs":  # camera estimation is slow
            inputs = data_identity(datasets.inputs(format, place, ())[0], {}, place)
        else:
            scene, _ = posed_scene(self.path)
            files = [file for name in scene.cameras for file in scene.sources(name)]
            inputs = data_identity(dict.fromkeys(files), scene.cameras, place)
        return {"name": self.name, "format": format, **inputs}

    def scene(self) -> Scene:
        """Read the scene; InputError if there is none."""
        return replace(posed_scene(self.path)[0], name=self.name)


@dataclass(frozen=True)
class Room:
    """A procedural room, by options of the format ``procedural``."""

    name: str
    options: Mapping[str, Any]

    def scene(self) -> Scene:
        """Generate the room."""
        return replace(datasets.load("procedural", **self.options), name=self.name)


def data_identity(
    files: Iterable[Path], cameras: Mapping[str, Camera], path: Path
) -> dict[str, Any]:
    """Return the identity of data by content, for a cache key.

    Args:
        files, cameras: Results of :func:`slgaussian.datasets.inputs`.
        path: Folder or file of the data.

    Returns:
        dict: ``files``: SHA-256 by path below the folder, from :func:`hash_files`. ``cameras``:
            SHA-256 of the ordered, named cameras.
    """
    numbers = [
        (name, asdict(camera) | {"K": camera.K.tolist(), "c2w": camera.c2w.tolist()})
        for name, camera in cameras.items()
    ]
    text = json.dumps(numbers, sort_keys=True)
    digests = hash_files(files, path if path.is_dir() else path.parent)
    return {"files": digests, "cameras": hashlib.sha256(text.encode()).hexdigest()}


def hash_files(files: Iterable[Path], folder: Path) -> dict[str, str]:
    """Compute the SHA-256 of files by path below a folder.

    Missing and unreadable files are skipped: their reader has a better message.
    """
    digests = {}
    for file in files:
        with suppress(OSError, ValueError):  # ValueError: invalid names
            digests[os.path.relpath(file, folder)] = file_digest(file)
    return digests
