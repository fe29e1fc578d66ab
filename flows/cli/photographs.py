"""Loading of photographs with cameras: given or estimated."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from flows.cli.splats import render_splat
from flows.config import SceneSettings, Settings
from flows.scenes import find_data_folder
from slgaussian.checks import natural_key, order_naturally
from slgaussian.datasets import colmap, unposed
from slgaussian.datasets.photographs import find_file, skip_unreadable
from slgaussian.datasets.recognise import posed_scene, recognise
from slgaussian.datasets.sharpness import blur, choose_keyframes, glance, small
from slgaussian.errors import InputError
from slgaussian.language import COMMON_OBJECTS
from slgaussian.scene import Camera, Sample, Scene

POSED = ("nerfstudio", "colmap", "llff")
"""Formats of cameras for the photographs of a benchmark."""


def load_photographs(
    photos: Sequence[str],
    cameras: Path | None,
    settings: Settings,
    keyframes: int | None = None,
    verbose: bool = True,
) -> tuple[Sample, dict[str, str]]:
    """Load photographs with their cameras, at the size of the settings.

    Without ``cameras``, those of precomputed geometry are used, else they are estimated, and a
    summary is printed. If there are more than ``keyframes`` photographs, that many are chosen.
    Photographs whose cameras cannot be estimated are left out with a warning; only one warning is
    printed unless ``verbose``.

    Returns:
        sample: Sample
        places: dict str -> str. Of all chosen photographs, also those without a camera: absolute
            paths by name or, if no file was given, names of views.

    Raises:
        InputError: If an argument cannot be used.
    """
    if settings.predictor == "gaussians" and not photos:
        return render_splat(cameras, settings)
    if settings.predictor == "gaussians" and cameras is None:
        raise InputError(
            "cameras: found none for the photographs of a splat, expected those by which it was "
            "trained, which share its world; give them, as in --cameras sparse/0"
        )
    if cameras is None and settings.predictor == "precomputed":
        cameras = _find_cameras(dict(settings.configure("predictor"))["geometry"])
    if cameras is None:
        files = unposed.name_files(photos)
        if keyframes is not None:
            looks = [glance(path.read_bytes())[0] for path in files.values()]
            files = {name: files[name] for name in _keyframes(list(files), looks, keyframes)}
        estimate = unposed.find(files)
        print_warnings(estimate.warnings, verbose)
        print(estimate.summary(), file=sys.stderr)
        scene = unposed.read_with_cameras(files, estimate)
        names = list(scene.cameras)
    else:
        scene, folder = posed_scene(cameras, photos)
        views = find_views(scene, photos, folder)
        names = [name for name, _ in views]
        if keyframes is not None:
            looks = [small(scene.read(name).image) for name in names]
            names = _keyframes(names, looks, keyframes, [scene.cameras[name] for name in names])
        files = {name: dict(views)[name] for name in names}
    places = {n: str(file.absolute()) if file.is_file() else n for n, file in files.items()}
    sample = scene.sample(names, size=settings.size, near=settings.near, far=settings.far)
    return sample, places


def _find_cameras(geometry: Path | None) -> Path | None:
    """Return the file or folder of precomputed geometry if it has cameras too."""
    from slgaussian.formats.depth_maps import numbered_views, read_geometry

    if geometry is None or not (
        numbered_views(geometry) or (geometry.suffix == ".npz" and geometry.is_file())
    ):
        return None
    stored = read_geometry(geometry)
    return None if stored.poses is None or stored.maps[0].K is None else geometry


@contextmanager
def begin_work(
    work: str, sample: Sample, components: Sequence[str], verbose: bool
) -> Iterator[None]:
    """Print what the work on a sample begins with, and the warnings of the block when it ends."""
    height, width = sample.context[0].image.shape[:2]
    names = f" with {', '.join(components)}" if components else ""
    print(f"{work} {len(sample.context)} views of {width}x{height}{names}", file=sys.stderr)
    with warnings.catch_warnings(record=True) as caught:
        yield
    print_warnings([str(warning.message) for warning in caught], verbose)


def print_warnings(texts: Sequence[str], verbose: bool) -> None:
    """Print all warnings if ``verbose``, else the first one and the number of the others."""
    for warning in texts if verbose else texts[:1]:
        rest = f" (and {len(texts) - 1} more, with -v)" if texts[1:] else ""
        print(f"warning: {warning}{'' if verbose else rest}", file=sys.stderr)


def find_views(scene: Scene, photos: Sequence[str], folder: Path) -> list[tuple[str, Path]]:
    """Find the views of a scene given by files, folders of files, or view names.

    A folder selects all photographs in it that have a camera and can be read. A photograph without
    an estimated camera is left out with a warning. Names of the views are relative to ``folder``.

    Returns:
        list of (str, path): Names of views, and files, which may be missing; in natural order if
            they were given in the order of letters, as a shell lists them.

    Raises:
        InputError: If a photograph, or all photographs in a folder, have no camera.
    """
    names = {(folder / name).resolve(): name for name in scene.cameras}
    left_out = {(folder / name).resolve(): reason for name, reason in scene.left_out.items()}
    views: list[tuple[str, Path]] = []
    for photo in photos:
        place = Path(photo).resolve()
        # Names of views may lack the suffix of their file.
        name = names.get(place) or names.get(place.parent / place.stem)
        if place.is_dir():
            within = (name for file, name in names.items() if file.is_relative_to(place))
            inside = sorted(within, key=natural_key)
            if not inside:
                raise InputError(
                    f"{photo}: none of the {len(names)} photographs that have a camera is in this "
                    f"folder; they are in {folder}"
                )
            stored = {find_file(folder / name) or folder / name: name for name in inside}
            views += [(stored[file], file) for file in skip_unreadable([*stored])]
        elif place in left_out:
            print(
                f"warning: {photo} has no camera, as it could not be estimated, and is left out: "
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
    files = dict(views)
    return [(name, files[name]) for name in order_naturally(name for name, _ in views)]


def held_out_scene(photos: Sequence[str], cameras: Path | None) -> SceneSettings:
    """Make a scene of photographs without labels, with the middle one as held-out target.

    Only the error of the rendered target view can be measured. Cameras are estimated from all
    photographs if ``cameras`` is None.

    Raises:
        InputError: If there are fewer than three photographs, or one is missing or has no camera.
    """
    if cameras is None:
        files = unposed.name_files(photos)
        names, place = list(files), unposed.find_folder(files)
        format, options = "photographs", dict[str, Any](only=list(files))
    else:
        format, place = recognise(cameras)
        if format not in POSED:
            raise InputError(f"{cameras}: found {format}, expected cameras of {', '.join(POSED)}")
        scene, folder = posed_scene(cameras, photos)
        names = [name for name, _ in find_views(scene, photos, folder)]
        options = {}
        if format != "nerfstudio":  # relative, so that the scene can be moved
            scene_folder = (
                colmap.scene_folder(place) if format == "colmap" else find_data_folder(place)
            )
            options["images"] = os.path.relpath(folder.resolve(), scene_folder.resolve())
    if len(names) < 3:
        raise InputError(
            f"benchmark: found {len(names)} photographs, expected at least three: the middle one "
            "is held out, and a field is built from the others"
        )
    target = names.pop(len(names) // 2)
    print(f"{target} is held out, to measure the error of a new view", file=sys.stderr)
    return SceneSettings(
        name=find_data_folder(place).name or "photographs",
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
    """Choose ``count`` of the views, and print their names."""
    chosen = [names[k] for k in choose_keyframes([blur(look) for look in looks], count, cameras)]
    listed = ", ".join(chosen[:4]) + (", ..." if len(chosen) > 4 else "")
    print(f"keyframes: {len(chosen)} of {len(names)} photographs, {listed}", file=sys.stderr)
    return chosen
