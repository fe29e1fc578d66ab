"""Evaluation index: context views and target views of each scene.

It is a JSON file, so that others can evaluate the same views::

    {"version": 2,
     "format": "lerf_ovs",
     "rule": {"name": "around", "version": 1, "min_overlap": 0.6, ...},
     "scenes": {
       "ramen-frame_00024": {
         "options": {"scene": "ramen"}, "labels": "label/ramen",
         "context": ["frame_00019.jpg", "frame_00031.jpg"], "target": ["frame_00024.jpg"],
         "categories": ["chopsticks", ...],
         "measured": {"overlap": 0.81, ...}}, ...},
     "left_out": {"ramen-frame_00006": "reason"}}

``format`` and ``options`` are arguments of :func:`slgaussian.datasets.load`; ``labels`` is a folder
relative to the folder of labels, by default that of the data. There may be more than two context
views. Without ``categories`` all labelled categories are queried; without labels only the images
are compared. Older files contain only ``scenes``, with context, target and categories. The
evaluation index published with pixelSplat and MVSplat can be read too: RealEstate10K clips by key,
with frame numbers and without categories. In 575 of its 6,474 clips a target is also a context
frame; such targets are left out.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, NonNegativeInt, model_validator

from slgaussian.errors import InputError
from slgaussian.formats.documents import check_document, read_json
from slgaussian.io import write_atomic

VERSION = 2


def _check_unique(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(names)) < len(names):
        raise ValueError("expected different names")
    return names


def _check_relative(folder: str) -> str:
    if PurePosixPath(folder).is_absolute() or ".." in PurePosixPath(folder).parts:
        raise ValueError("expected a folder below the labels")
    return folder


_Names = Annotated[
    tuple[Annotated[str, Field(pattern=r"\S")], ...],
    Field(min_length=1),
    AfterValidator(_check_unique),
]


class ScenePair(BaseModel):
    """Two or more context views, the held-out target views, and the queries in the targets.

    Attributes:
        options: Arguments of the reader besides the path.
        labels: Folder of the labels, relative to the folder of all labels.
        context, target: tuple of str. View names, without overlap.
        categories: tuple of str, or None to query all labelled categories of the targets.
        measured: {name: number}. Measures by which the pair was chosen.
    """

    model_config = ConfigDict(frozen=True)

    options: dict[str, Any] = {}
    labels: Annotated[str, AfterValidator(_check_relative)] = ""
    context: Annotated[_Names, Field(min_length=2)]
    target: _Names
    categories: _Names | None = None
    measured: dict[str, Any] = {}

    @model_validator(mode="after")
    def _check_targets(self) -> ScenePair:
        if shared := sorted({*self.context} & {*self.target}):
            raise ValueError(f"{shared[0]!r} is both context and target; a target must be held out")
        return self


class Index(BaseModel):
    """An index file.

    Attributes:
        format: Data format; empty if not in the file.
        rule: Rule by which the pairs were chosen, with its settings; empty if not in the file.
        scenes: {name: ScenePair}. Names are those of tables and folders.
        left_out: {name: str}. Reasons by labelled frame without a pair.
    """

    format: str
    rule: dict[str, Any]
    scenes: dict[str, ScenePair]
    left_out: dict[str, str]


class _Clip(BaseModel):
    """A clip of a published index file, with frame numbers."""

    context: Annotated[list[NonNegativeInt], Field(min_length=1)]
    target: Annotated[list[NonNegativeInt], Field(min_length=1)]


def read_index(path: str | Path) -> Index:
    """Read an index in any of the three formats.

    Raises:
        InputError: If the file is missing, invalid or of a newer version, a target is also a
            context view, or a list is too short or has duplicates.
    """
    path = Path(path)
    content = read_json(path, "pair index")
    if not isinstance(content, dict) or not content:
        raise InputError(f"{path}: found {content!r:.60}, expected an object of scenes")
    if all(
        entry is None or (isinstance(entry, dict) and entry.keys() == {"context", "target"})
        for entry in content.values()
    ):
        return _read_published_index(path, content)
    if not isinstance(content.get("version"), int):
        for name, entry in content.items():
            if isinstance(entry, dict) and entry.get("categories") is None:
                raise InputError(f"{path}: scene {name!r}: categories is missing")
        content = {"format": "", "rule": {}, "scenes": content, "left_out": {}}
    elif content["version"] != VERSION:
        raise InputError(
            f"{path}: found version {content['version']}, expected at most {VERSION}; create it "
            "again with `slgaussian benchmark`, or install a newer slgaussian"
        )
    if isinstance(scenes := content.get("scenes"), dict):
        content["scenes"] = {
            name: check_document(ScenePair, entry, f"{path}: scene {name!r}")
            for name, entry in scenes.items()
        }
    return check_document(Index, content, str(path))


def write_index(path: str | Path, index: Index) -> None:
    """Write an index as version 2; the same index gives the same bytes."""
    content = {"version": VERSION, **index.model_dump(mode="json")}
    try:
        write_atomic(path, (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode())
    except OSError as error:
        raise InputError(f"{path}: cannot write the index ({error.strerror})") from error


def _read_published_index(path: Path, content: Mapping[str, Any]) -> Index:
    """Read a published index; targets that are context frames of the same clip are left out."""
    scenes, left_out = {}, {}
    for key, entry in content.items():
        if entry is None:
            continue
        clip = check_document(_Clip, entry, f"{path}: clip {key!r}")
        context, targets = (
            [str(frame) for frame in dict.fromkeys(frames)]
            for frames in (clip.context, clip.target)
        )
        for name in targets:
            if name in context:
                left_out[f"{key}/{name}"] = "is both context and target; a target must be held out"
        held_out = [name for name in targets if name not in context]
        if len(context) < 2 or not held_out:
            left_out[key] = (
                f"context {context} and target {targets}: expected two views and a third"
            )
            continue
        pair = {"options": {"key": key}, "labels": key, "context": context, "target": held_out}
        scenes[key] = check_document(ScenePair, pair, f"{path}: clip {key!r}")
    return Index(format="re10k", rule={}, scenes=scenes, left_out=left_out)
