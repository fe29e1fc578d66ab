"""Scenes of any format as chunks of one clip, so that they go down the road that a corpus does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian import datasets
from slgaussian.datasets import licences, re10k, re10k_text
from slgaussian.datasets.recognise import posed_scene, recognise
from slgaussian.errors import InputError
from slgaussian.scene import Scene
from slgaussian.storage.provenance import saying
from slgaussian.storage.store import ArtifactRef
from tasks.chunks import left_out
from tasks.context import RunContext
from tasks.ingest import known_by, told_of
from tasks.stage import stage


@dataclass(frozen=True)
class PosedFolder:
    """A folder or file with the cameras of one scene, or with photographs alone.

    Attributes
    ----------
    name : str
        What its clip is called.
    path : Path
    """

    name: str
    path: Path

    def identity(self) -> dict[str, Any]:
        """What it is known by: its name, and what is in its files."""
        format, place = recognise(self.path)
        if format == "photographs":  # whose cameras take long to find
            inputs = known_by(datasets.inputs(format, place, ())[0], {}, place)
        else:
            scene, _ = posed_scene(self.path)
            files = [file for name in scene.cameras for file in scene.sources(name)]
            inputs = known_by(dict.fromkeys(files), scene.cameras, place)
        return {"name": self.name, "format": format, **inputs}

    def scene(self) -> Scene:
        """The scene; InputError if there is none."""
        return replace(posed_scene(self.path)[0], name=self.name)

    def url(self) -> str:
        """Address of the video that it is from, if it says so."""
        format, place = recognise(self.path)
        return re10k_text.read_cameras(place)[0] if format == "re10k_text" else ""

    def origin(self) -> tuple[str, str]:
        """Where it is from, and its licence, as far as they are known."""
        return self.url(), licences.stated(self.path)


@dataclass(frozen=True)
class Room:
    """A made-up room by its seed, with options of the format ``procedural``."""

    name: str
    options: Mapping[str, Any]

    def scene(self) -> Scene:
        """The room."""
        return replace(datasets.load("procedural", **self.options), name=self.name)

    def url(self) -> str:
        """None: it is of no video."""
        return ""

    def origin(self) -> tuple[str, str]:
        """Where it is from, and its licence."""
        return datasets.SOURCES["procedural"]


@stage("packed", version=2)  # to be raised too when other cameras are found in photographs
def packed(run: RunContext, source: PosedFolder | Room) -> ArtifactRef:
    """The scene of a source as a chunk of one clip: spec ``packed``.

    ``meta["cameras"]`` says whether its cameras were given, or found and how surely;
    ``meta["left_out"]`` which photographs could not be read.
    """
    scene = source.scene()
    bad: list[dict[str, str]] = []

    def pass_over(error: InputError) -> None:
        bad.append(left_out(source.name, error))

    clip = re10k.clip_of(scene, source.url(), pass_over)
    unplaced = scene.found.get("left_out", {})
    bad += [left_out(source.name, InputError(f"{n}: {why}")) for n, why in unplaced.items()]
    data = np.frombuffer(re10k.encoded([clip]), np.uint8)
    meta = {"cameras": told_of(scene.cameras.values()), "left_out": bad}
    with saying(*source.origin()):
        return run.store.put("packed", {"torch": data}, meta)
