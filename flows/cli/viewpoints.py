"""Cameras to look from: a field's own views, those of a file, between two, or along a turn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import NoReturn

import numpy as np

from slgaussian.cameras import paths
from slgaussian.errors import InputError
from slgaussian.scene import Camera, Scene

MOST_FRAMES = 2000


@dataclass(frozen=True)
class Viewpoint:
    """A camera, its name, and a caption of pictures that are rendered from it."""

    name: str
    caption: str
    camera: Camera


def choose_viewpoints(
    source: Path,
    cameras: Mapping[str, Camera],
    views: Sequence[str] | None,
    file: Path | None = None,
    between: tuple[str, str, float] | None = None,
) -> list[Viewpoint]:
    """Return the viewpoints that options name.

    Parameters
    ----------
    source : path
        The field, as messages call it.
    cameras : mapping str -> Camera
        Its own cameras by view.
    views : sequence of str
        Names of views, or numbers from 0; the first view if left out.
    file : path, optional
        Camera file whose views are meant in place of those of the field.
    between : (str, str, float), optional
        In place of views: two of them, and the share of the way from one to the other.

    Raises
    ------
    InputError
        If there is no such view, or views are given beside ``between``.
    """
    if file is not None:
        from slgaussian.datasets.recognise import cameras_in

        source, cameras = file, cameras_in(file)
    scene = Scene(str(source), cameras, read=_refuse_to_read)
    if between is None:
        names = [find_view(scene, view) for view in views or ["0"]]
        return [Viewpoint(n, f"rendering at {_short(n)}", cameras[n]) for n in names]
    if views:
        raise InputError("--view and --between: are two ways to look; give one of them")

    *ends, share = between
    a, b = (find_view(scene, str(view)) for view in ends)
    camera = paths.between(cameras[a], cameras[b], share)
    caption = f"rendering between {_short(a)} and {_short(b)} at {share:g}"
    return [Viewpoint(f"between {a} and {b} at {share:g}", caption, camera)]


def turn_viewpoints(cameras: Sequence[Camera], points: np.ndarray, frames: int) -> list[Viewpoint]:
    """Return the viewpoints of a short turn among the cameras, aimed at points [N, 3].

    Raises
    ------
    InputError
        If the number of frames is out of range.
    """
    from slgaussian.cameras.paths import orbit

    if not 2 <= frames <= MOST_FRAMES:
        raise InputError(
            f"--orbit: found {frames}, expected a number of frames from 2 to {MOST_FRAMES}"
        )
    return [
        Viewpoint(f"turn {k} of {frames}", f"rendering, turn {k} of {frames}", camera)
        for k, camera in enumerate(orbit(cameras, points, frames), 1)
    ]


def find_view(scene: Scene, view: str) -> str:
    """Return the name of the view called ``view``, or of that number; InputError if none is."""
    names = list(scene.cameras)
    if view.isdecimal() and str(int(view)) == view and int(view) < len(names):
        return names[int(view)]
    return scene.find(view)


def _refuse_to_read(name: str) -> NoReturn:
    raise InputError(f"{name}: a field holds no photographs")


def _short(name: str) -> str:
    return PurePosixPath(name).name
