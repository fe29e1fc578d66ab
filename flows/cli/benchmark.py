"""One's own photographs as a scene of a run, one of them held out."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from flows.cli.posing import listed_photographs, view_of
from flows.settings import SceneSettings, Settings
from slgaussian.datasets import unposed
from slgaussian.datasets.recognise import posed_scene, recognise
from slgaussian.errors import InputError
from slgaussian.things import COMMON_THINGS

CAMERAS = ("nerfstudio", "colmap", "llff")
"""Formats of cameras that are read beside photographs."""


def with_photographs(settings: Settings, photos: Sequence[str], cameras: Path | None) -> Settings:
    """Return the settings with a scene of one's own photographs, and say which one is held out.

    Raises
    ------
    InputError
        As :func:`own_scene`, or if cameras are given alone.
    """
    if not photos:
        raise InputError("--cameras: is given without photographs; name them, or leave it out")
    scene, message = own_scene(photos, cameras)
    print(message, file=sys.stderr)
    return settings.model_copy(update={"scenes": [*settings.scenes, scene]})


def own_scene(photos: Sequence[str], cameras: Path | None) -> tuple[SceneSettings, str]:
    """Photographs, or a folder of them, as a scene, and what is to be said of it.

    Of three or more one is held out: the last that is named, or the middle one of a folder. Without
    cameras these are found, from all photographs together.

    Raises
    ------
    InputError
        If a photograph cannot be found, or has no camera among those given.
    """
    files = unposed.named(photos)
    middle = len(photos) == 1
    if cameras is None:
        for file in files.values():
            if not file.is_file():
                raise InputError(f"{file}: is no file; give photographs, or a folder of them")
        names = list(files)
        folder = unposed.folder_of(files)
        context, targets = held_out(names, middle)
        scene = SceneSettings(
            name=folder.name or "photographs",
            dataset="photographs",
            format="photographs",
            options={"only": names},
            path=folder,
            context=context,
            targets=targets,
            queries=list(COMMON_THINGS),
        )
        return scene, _said(targets)
    format, place = recognise(cameras)
    if format not in CAMERAS:
        raise InputError(
            f"{cameras}: found {format}, expected cameras of {', '.join(CAMERAS)}; give other data "
            "with --data and --pairs"
        )
    known, start = posed_scene(cameras, photos)
    folder = place if place.is_dir() else place.parent
    names = [view_of(known, photo, start) for photo in listed_photographs(known, photos, start)]
    context, targets = held_out(names, middle)
    scene = SceneSettings(
        name=folder.resolve().name or "photographs",
        dataset="photographs",
        format=format,
        options={} if format == "nerfstudio" else {"images": str(start.resolve())},
        path=place,
        context=context,
        targets=targets,
        queries=list(COMMON_THINGS),
    )
    return scene, _said(targets)


def held_out(names: Sequence[str], middle: bool) -> tuple[list[str], list[str]]:
    """Those that a field is built from, and the one that it is judged by, if there are three."""
    if len(names) < 3:
        return list(names), []
    left = len(names) // 2 if middle else len(names) - 1
    return [name for k, name in enumerate(names) if k != left], [names[left]]


def _said(targets: Sequence[str]) -> str:
    if targets:
        return f"{targets[0]} is held out: it shows the error of a new view"
    return "of two photographs none is held out; add a third from between them to see an error"
