"""Settings of a benchmark: the index of its data, and photographs as a scene."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flows.cli.load_views import listed_photographs, view_of
from flows.corpus_settings import IndexSettings, check_bounds
from flows.settings import SceneSettings, Settings, checked, make_settings
from slgaussian.datasets import check_format, unposed
from slgaussian.datasets.recognise import posed_scene, recognise
from slgaussian.errors import InputError
from slgaussian.things import COMMON_THINGS

CAMERAS = ("nerfstudio", "colmap", "llff")
"""Formats of cameras that are read beside photographs."""


def benchmark_settings(
    values: dict[str, Any], photos: Sequence[str], cameras: Path | None
) -> Settings:
    """Return the settings of a benchmark, with a scene of photographs if some are given.

    Of data without an index, the context views of labelled frames are chosen first, by the fields
    of :class:`flows.corpus_settings.IndexSettings` among ``values``, into ``pairs.json`` of the
    output folder.

    Raises
    ------
    InputError
        If a value does not fit or has no effect, no pair can be chosen, or the photographs and
        cameras cannot be used.
    """
    rule = {key: values.pop(key) for key in IndexSettings.model_fields if key in values}
    if "format" in rule:
        values["format"] = rule["format"]
    settings = make_settings(values, "benchmark")
    if settings.data is not None and settings.pairs is None:
        pairs = _indexed(settings, settings.data, rule)
        settings = settings.model_copy(update={"pairs": pairs})
    elif given := rule.keys() - {"format"}:
        raise InputError(
            f"benchmark: {min(given)}: context views are chosen only of --data without --pairs; "
            "leave it out"
        )
    if not photos and cameras is None:
        return settings
    if not photos:
        raise InputError("--cameras: is given without photographs; name them, or leave it out")
    scene = scene_of_photographs(photos, cameras)
    if scene.targets:
        message = f"{scene.targets[0]} is held out: it shows the error of a new view"
    else:
        message = (
            "of two photographs none is held out; add a third from between them to see an error"
        )
    print(message, file=sys.stderr)
    return settings.model_copy(update={"scenes": [*settings.scenes, scene]})


def _indexed(settings: Settings, data: Path, rule: dict[str, Any]) -> Path:
    """Choose context views for the labelled frames of the data; return the index file."""
    chosen = checked(IndexSettings, rule, "benchmark")
    check_bounds(chosen, "benchmark")
    from flows.indexing import build_index
    from flows.runners.environment import home_of, prepare
    from slgaussian.storage.store import ArtifactStore

    prepare(home_of(ArtifactStore(settings.store)))  # before Prefect is imported
    from flows.runners.session import check_folder

    check_format(chosen.format)
    check_folder(settings.out)
    file = settings.out / "pairs.json"
    index = build_index(data, settings.labels, chosen, file)
    for name, reason in index.left_out.items():
        print(f"left out: {name}: {reason}", file=sys.stderr)
    print(f"{len(index.pairs)} pairs  {file}", file=sys.stderr)
    return file


def scene_of_photographs(photos: Sequence[str], cameras: Path | None) -> SceneSettings:
    """Return photographs, or a folder of them, as a scene.

    Of three or more one is held out: the last that is named, or the middle one of a folder. Without
    cameras these are estimated, from all photographs together.

    Raises
    ------
    InputError
        If a photograph cannot be found, or has no camera among those given.
    """
    files = unposed.named(photos)
    options: dict[str, Any]
    if cameras is None:
        for file in files.values():
            if not file.is_file():
                raise InputError(f"{file}: is no file; give photographs, or a folder of them")
        names = list(files)
        folder = place = unposed.folder_of(files)
        format, options = "photographs", {"only": names}
    else:
        format, place = recognise(cameras)
        if format not in CAMERAS:
            raise InputError(
                f"{cameras}: found {format}, expected cameras of {', '.join(CAMERAS)}; give other "
                "data with --data and --pairs"
            )
        known, start = posed_scene(cameras, photos)
        folder = (place if place.is_dir() else place.parent).resolve()
        names = [view_of(known, photo, start) for photo in listed_photographs(known, photos, start)]
        options = {} if format == "nerfstudio" else {"images": str(start.resolve())}
    context, targets = held_out(names, middle=len(photos) == 1)
    return SceneSettings(
        name=folder.name or "photographs",
        dataset="photographs",
        format=format,
        options=options,
        path=place,
        context=context,
        targets=targets,
        queries=list(COMMON_THINGS),
    )


def held_out(names: Sequence[str], middle: bool) -> tuple[list[str], list[str]]:
    """Return those that a field is built from, and the one to judge it by, if there are three."""
    if len(names) < 3:
        return list(names), []
    left = len(names) // 2 if middle else len(names) - 1
    return [name for k, name in enumerate(names) if k != left], [names[left]]
