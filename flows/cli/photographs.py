"""Load the photographs of a command with cameras: given, estimated, or estimated anew."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flows.config import SceneSettings, Settings
from slgaussian.cameras.estimated import EstimatedCameras
from slgaussian.datasets import unposed
from slgaussian.datasets.keyframes import choose_keyframes
from slgaussian.datasets.recognise import posed_scene, recognise
from slgaussian.datasets.sharpness import blur, glance, small
from slgaussian.errors import InputError
from slgaussian.objects import COMMON_OBJECTS
from slgaussian.scene import Camera, Sample, Scene

POSED = ("nerfstudio", "colmap", "llff")
"""Formats of cameras that are read beside the photographs of a benchmark."""


def load_photographs(
    photos: Sequence[str],
    cameras: Path | None,
    refine: bool,
    settings: Settings,
    keyframes: int | None = None,
    verbose: bool = True,
) -> tuple[Sample, dict[str, str]]:
    """Load photographs with their cameras, at the size that the settings ask for.

    Cameras that are left out are those of precomputed geometry, if it has some, or else estimated;
    with ``refine`` they are estimated anew, in the same world; how is printed. Of more photographs,
    ``keyframes`` are taken. Those that cannot be placed are left out with a warning; of several
    warnings one is printed unless ``verbose``.

    Returns
    -------
    sample : Sample
    places : dict str -> str
        Of all photographs that were taken, also those that could not be placed: paths from the
        root by name or, where no file was given, names of views.

    Raises
    ------
    InputError
        If anything given cannot be used.
    """
    if cameras is None and settings.predictor == "precomputed":
        cameras = _cameras_of(settings.precomputed.geometry)
    if cameras is None:
        if refine:
            raise InputError(
                "--refine: finds given cameras anew, and none are given; leave it out, or add "
                "--cameras"
            )
        files = unposed.named(photos)
        if keyframes is not None:
            looks = [glance(path.read_bytes())[0] for path in files.values()]
            files = {name: files[name] for name in _keyframes(list(files), looks, keyframes)}
        estimate = unposed.find(files)
        _print_cameras(estimate, verbose)
        scene = unposed.posed(files, estimate)
        names = list(scene.cameras)
    else:
        scene, folder = posed_scene(cameras, photos)
        views = find_views(scene, photos, folder)
        names = [name for name, _ in views]
        if keyframes is not None:
            looks = [small(scene.read(name).image) for name in names]
            names = _keyframes(names, looks, keyframes, [scene.cameras[name] for name in names])
        files = {name: dict(views)[name] for name in names}
        if refine:
            existing = {name: file for name, file in files.items() if file.is_file()}
            scene, estimate = unposed.refined(scene, names, existing)
            _print_cameras(estimate, verbose)
            names = list(scene.cameras)
    places = {n: str(file.absolute()) if file.is_file() else n for n, file in files.items()}
    sample = scene.sample(names, size=settings.size, near=settings.near, far=settings.far)
    return sample, places


def _cameras_of(geometry: Path | None) -> Path | None:
    """Return the file of precomputed geometry if it holds cameras too."""
    if geometry is None or geometry.suffix != ".npz" or not geometry.is_file():
        return None
    from slgaussian.formats.depth_maps import read_geometry

    stored = read_geometry(geometry)
    return None if stored.poses is None or stored.maps[0].K is None else geometry


def _print_cameras(estimate: EstimatedCameras, verbose: bool) -> None:
    print_warnings(estimate.warnings, verbose)
    print(estimate.summary(), file=sys.stderr)


def print_warnings(warnings: Sequence[str], verbose: bool) -> None:
    """Print warnings: all, or else the first and how many there are more."""
    for warning in warnings if verbose else warnings[:1]:
        rest = f" (and {len(warnings) - 1} more, with -v)" if warnings[1:] else ""
        print(f"warning: {warning}{'' if verbose else rest}", file=sys.stderr)


def find_views(scene: Scene, photos: Sequence[str], folder: Path) -> list[tuple[str, Path]]:
    """Find the views of a scene that are named, by their files, folders of these, or view names.

    Of a folder, those in it that have a camera are taken. A photograph that was left out when the
    cameras were estimated is left out with a warning. The views of the scene are named from
    ``folder``.

    Returns
    -------
    list of (str, path)
        Names of views, and files, which may be missing.

    Raises
    ------
    InputError
        If a photograph, or all in a folder, have no camera.
    """
    names = {(folder / name).resolve(): name for name in scene.cameras}
    left_out = {(folder / name).resolve(): reason for name, reason in scene.left_out.items()}
    views: list[tuple[str, Path]] = []
    for photo in photos:
        place = Path(photo).resolve()
        # Views may be named without the suffix of their file.
        name = names.get(place) or names.get(place.parent / place.stem)
        if place.is_dir():
            inside = sorted(name for file, name in names.items() if file.is_relative_to(place))
            if not inside:
                raise InputError(
                    f"{photo}: none of the {len(names)} photographs that have a camera lies in "
                    f"this folder; they are in {folder}"
                )
            views += [(name, folder / name) for name in inside]
        elif place in left_out:
            print(
                f"warning: {photo} could not be placed when cameras were found, and is left out: "
                f"{left_out[place]}",
                file=sys.stderr,
            )
        elif name is None and place.is_file():
            raise InputError(
                f"{photo}: no camera for this photograph; {folder} has cameras for {len(names)}, "
                f"such as {', '.join(list(scene.cameras)[:4])}: give one of them, or add a camera"
            )
        else:
            views.append((name or scene.find(photo), Path(photo)))
    return views


def held_out_scene(photos: Sequence[str], cameras: Path | None) -> SceneSettings:
    """Make a scene of photographs without labels, the middle one of which is held out.

    The error of the view that is drawn in its place is all that can be measured then. Cameras are
    estimated from all photographs together if they are left out.

    Raises
    ------
    InputError
        If there are fewer than three, or one cannot be found or has no camera.
    """
    if cameras is None:
        files = unposed.named(photos)
        names, place = list(files), unposed.folder_of(files)
        format, options = "photographs", dict[str, Any](only=list(files))
    else:
        format, place = recognise(cameras)
        if format not in POSED:
            raise InputError(f"{cameras}: found {format}, expected cameras of {', '.join(POSED)}")
        scene, folder = posed_scene(cameras, photos)
        names = [name for name, _ in find_views(scene, photos, folder)]
        options = {} if format == "nerfstudio" else {"images": str(folder.resolve())}
    if len(names) < 3:
        raise InputError(
            f"benchmark: found {len(names)} photographs, expected three at least: the middle one "
            "is held out, and a field is built from the others"
        )
    target = names.pop(len(names) // 2)
    print(f"{target} is held out: it shows the error of a new view", file=sys.stderr)
    return SceneSettings(
        name=(place if place.is_dir() else place.parent).resolve().name or "photographs",
        dataset="photographs",
        format=format,
        options=options,
        path=place,
        context=names,
        targets=[target],
        queries=list(COMMON_OBJECTS),
    )


def _keyframes(
    names: Sequence[str],
    looks: Sequence[np.ndarray],
    count: int,
    cameras: Sequence[Camera] | None = None,
) -> list[str]:
    """Choose so many of the views, and print which."""
    chosen = [names[k] for k in choose_keyframes([blur(look) for look in looks], count, cameras)]
    some = ", ".join(chosen[:4]) + (", ..." if len(chosen) > 4 else "")
    print(f"keyframes: {len(chosen)} of {len(names)} photographs, {some}", file=sys.stderr)
    return chosen
