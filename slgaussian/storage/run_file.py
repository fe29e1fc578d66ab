"""``run.toml`` beside a report: a configuration that repeats the run, and its inputs."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import Field

from slgaussian import __version__
from slgaussian.components.config import Config
from slgaussian.errors import InputError
from slgaussian.kernels import threads
from slgaussian.storage import provenance
from slgaussian.storage.store import ArtifactRef

_HEAD = """\
# The run whose report lies beside this file. To repeat it, in this folder:
#   slgaussian run run.toml -o again
# Relative paths are relative to this file; change them if the data are elsewhere. The data are
# first compared with [inputs]. To use other data, delete its tables, at the end of the file.

"""


class SceneInputs(Config):
    """SHA-256 of the photographs and labels of a scene by name, and of its cameras."""

    cameras: str = ""
    files: dict[str, str] = Field({})
    labels: dict[str, str] = Field({})

    @staticmethod
    def from_settings(photographs: Mapping[str, Any], labels: Mapping[str, str]) -> SceneInputs:
        """Return the digests; ``photographs`` has those of ``files`` and ``cameras``."""
        # Sorted, as records in the store do not preserve the order.
        files, labels = (dict(sorted(each.items())) for each in (photographs["files"], labels))
        cameras = photographs["cameras"] if files else ""
        return SceneInputs(cameras=cameras, files=files, labels=labels)

    def by_name(self) -> dict[str, str]:
        """Return all digests by kind and name; empty for a scene without files."""
        named = {"cameras": self.cameras} if self.cameras else {}
        named |= {f"photograph {name}": digest for name, digest in self.files.items()}
        return named | {f"label file {name}": digest for name, digest in self.labels.items()}


class Inputs(Config):
    """Versions, and SHA-256 of the files of components and of the data of all scenes.

    The data of a variant with other context views are under ``"SCENE: METHOD"``.
    """

    software: dict[str, str] = Field({})
    weights: dict[str, str] = Field({})
    scenes: dict[str, SceneInputs] = Field({})

    @staticmethod
    def from_refs(
        refs: Mapping[tuple[str, str], Mapping[str, ArtifactRef]], weights: dict[str, str]
    ) -> Inputs:
        """Return the inputs of results of stages by scene and method, the main method first."""
        scenes = dict[str, SceneInputs]()
        for (scene, method), by_stage in refs.items():
            if "ingest" in by_stage:  # baselines read nothing
                settings = {name: ref.meta["settings"] for name, ref in by_stage.items()}
                labels = settings["truth"]["labels"]["files"] if "truth" in settings else {}
                read = SceneInputs.from_settings(settings["ingest"]["photographs"], labels)
                if read != scenes.get(scene):
                    scenes[f"{scene}: {method}" if scene in scenes else scene] = read
        return Inputs(software=software(), weights=weights, scenes=scenes)

    def check(self, present: Inputs, source: str) -> list[str]:
        """Compare the present inputs with these of file ``source``; describe the result in lines.

        Raises:
            InputError: If a digest differs; it names the file, or the first of several.
        """
        count, unknown = 0, list[str]()
        pairs = [("weights", self.weights, present.weights)]
        for scene, inputs in present.scenes.items():
            recorded = self.scenes.get(scene, SceneInputs()).by_name()
            pairs.append((f"scene {scene!r}", recorded, inputs.by_name()))
            unknown += [] if recorded else [scene]
        for what, recorded, actual in pairs:
            if recorded and (names := _differing(recorded, actual)):
                digest, expected = (of.get(names[0], "none")[:12] for of in (actual, recorded))
                rest = f" (and {len(names) - 1} more)" if names[1:] else ""
                raise InputError(
                    f"{what}: {names[0]}{rest} is not that of the run: found digest {digest}, "
                    f"expected {expected}; bring the file of the run or, to use other data, delete "
                    f"the tables [inputs] from {source}"
                )
            count += len(recorded)
        rest = f"; nothing to compare of {', '.join(unknown)}" if unknown else ""
        lines = [f"{count} digests are those of {source}{rest}"]
        for name in _differing(self.software, present.software):
            here, there = (of.get(name, "none") for of in (present.software, self.software))
            lines.append(f"warning: results may differ, with {name} {here} instead of {there}")
        return lines


class Recorded(Config):
    """The tables of the file that are no settings."""

    inputs: Inputs | None = None


def _differing(first: Mapping[str, str], second: Mapping[str, str]) -> list[str]:
    return [name for name in {**first, **second} if first.get(name) != second.get(name)]


def software() -> dict[str, str]:
    """Return version and commit of the program, versions of packages, and the processor."""
    machine = threads.kernels()
    machine["instructions"] = machine.pop("torch")
    versions = {"slgaussian": __version__, "commit": provenance.commit()}
    return {**versions, **provenance.software(), **machine}


def encode(
    values: dict[str, Any], places: Mapping[str, Iterable[str]], inputs: Inputs, folder: Path
) -> bytes:
    """Return the content of the file in a folder.

    Args:
        values: Settings as plain data without None; places are replaced.
        places: Names of the fields that are files, for each table of a component.
    """
    folder = folder.resolve()
    for scene in values["scenes"]:
        for field in scene.keys() & {"path", "labels"}:
            scene[field] = _portable(scene[field], folder)
    for table, fields in places.items():
        for field in values[table].keys() & set(fields):
            if os.path.exists(values[table][field]):  # else a name on the hub
                values[table][field] = _portable(values[table][field], folder)
    content = {**values, "inputs": inputs.model_dump(exclude_defaults=True)}
    return (_HEAD + tomli_w.dumps(content)).encode()


def _portable(path: str, folder: Path) -> str:
    """Return a path, relative to a folder if both are below one folder."""
    path = os.path.abspath(path)
    is_near = os.path.commonpath([path, folder]) != os.path.sep
    return os.path.relpath(path, folder) if is_near else path
