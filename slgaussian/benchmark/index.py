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
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, Field, NonNegativeInt, model_validator

from slgaussian.benchmark.documents import check_document, read_json
from slgaussian.errors import InputError
from slgaussian.io import write_atomic

VERSION = 2


@dataclass(frozen=True)
class ScenePair:
    """Two or more context views, the held-out target views, and the queries in the targets.

    Attributes:
        scene: Name of the pair in tables and folders.
        context, targets: tuple of str. View names, without overlap.
        categories: tuple of str. Empty if the index has none: all labelled categories of the
            targets are queried.
        labels: Folder of the labels, relative to the folder of all labels.
        options: Arguments of the reader besides the path.
        measured: {name: float}. Measures by which the pair was chosen.
    """

    scene: str
    context: tuple[str, ...]
    targets: tuple[str, ...]
    categories: tuple[str, ...] = ()
    labels: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    measured: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Index:
    """An index file.

    Attributes:
        pairs: tuple of ScenePair. In the order of the file.
        format: Data format; None if not in the file.
        rule: Rule by which the pairs were chosen, with its settings; empty if not in the file.
        left_out: {name: str}. Reasons by labelled frame without a pair.
    """

    pairs: tuple[ScenePair, ...]
    format: str | None = None
    rule: Mapping[str, Any] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)


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
        return _read_published(path, content)
    if not isinstance(content.get("version"), int):
        for name, entry in content.items():
            if isinstance(entry, dict) and entry.get("categories") is None:
                raise InputError(f"{path}: scene {name!r}: categories is missing")
        return Index(tuple(_parse_pair(path, name, entry) for name, entry in content.items()))
    if content["version"] != VERSION:
        raise InputError(
            f"{path}: found version {content['version']}, expected at most {VERSION}; create it "
            "again with `slgaussian benchmark`, or install a newer slgaussian"
        )
    document = check_document(_Document, content, str(path))
    pairs = tuple(_parse_pair(path, name, entry) for name, entry in document.scenes.items())
    return Index(pairs, document.format, document.rule, document.left_out)


def write_index(path: str | Path, index: Index) -> None:
    """Write an index as version 2; the same index gives the same bytes."""
    scenes = {
        pair.scene: {
            "options": dict(pair.options),
            "labels": pair.labels,
            "context": list(pair.context),
            "target": list(pair.targets),
            "categories": list(pair.categories),
            "measured": dict(pair.measured),
        }
        for pair in index.pairs
    }
    content = {
        "version": VERSION,
        "format": index.format,
        "rule": dict(index.rule),
        "scenes": scenes,
        "left_out": dict(index.left_out),
    }
    try:
        write_atomic(path, (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode())
    except OSError as error:
        raise InputError(f"{path}: cannot write the index ({error.strerror})") from error


def _read_published(path: Path, content: Mapping[str, Any]) -> Index:
    """Read a published index; targets that are context frames of the same clip are left out."""
    pairs, left_out = [], {}
    for key, entry in content.items():
        if entry is None:
            continue
        clip = check_document(_Clip, entry, f"{path}: clip {key!r}")
        context, targets = (list(map(str, frames)) for frames in (clip.context, clip.target))
        for name in targets:
            if name in context:
                left_out[f"{key}/{name}"] = "is both context and target; a target must be held out"
        held_out = tuple(name for name in targets if name not in context)
        if len(set(context)) < 2 or not held_out:
            left_out[key] = (
                f"context {context} and target {targets}: expected two views and a third"
            )
            continue
        pairs.append(ScenePair(key, tuple(context), held_out, labels=key, options={"key": key}))
    return Index(tuple(pairs), "re10k", left_out=left_out)


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


class _Scene(BaseModel):
    """A scene of an index file."""

    context: Annotated[_Names, Field(min_length=2)]
    target: _Names
    categories: _Names | None = None
    labels: Annotated[str, AfterValidator(_check_relative)] = ""
    options: dict[str, Any] = {}
    measured: dict[str, Any] = {}

    @model_validator(mode="after")
    def _check_targets(self) -> _Scene:
        if shared := sorted({*self.context} & {*self.target}):
            raise ValueError(f"{shared[0]!r} is both context and target; a target must be held out")
        return self


class _Clip(BaseModel):
    """A clip of a published index file, with frame numbers."""

    context: Annotated[list[NonNegativeInt], Field(min_length=1)]
    target: Annotated[list[NonNegativeInt], Field(min_length=1)]


class _Document(BaseModel):
    """An index file of this version; its scenes are validated one by one."""

    format: str
    rule: dict[str, Any]
    scenes: dict[str, Any]
    left_out: dict[str, str]


def _parse_pair(path: Path, scene: str, entry: Any) -> ScenePair:
    pair = check_document(_Scene, entry, f"{path}: scene {scene!r}")
    return ScenePair(
        scene,
        pair.context,
        pair.target,
        pair.categories or (),
        pair.labels,
        pair.options,
        pair.measured,
    )
