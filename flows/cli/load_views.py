"""Load the photographs of a command with cameras: given, estimated, or estimated anew."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from flows.cli.cameras import report
from flows.settings import Settings
from slgaussian.datasets import unposed
from slgaussian.datasets.keyframes import choose_keyframes
from slgaussian.datasets.recognise import posed_scene
from slgaussian.datasets.sharpness import blur, glance, small
from slgaussian.errors import InputError
from slgaussian.predict.links import usable
from slgaussian.scene import Camera, Sample, Scene


def load_views(
    photos: Sequence[str],
    cameras: Path | None,
    refine: bool,
    method: Settings,
    keyframes: int | None = None,
) -> tuple[Sample, dict[str, str]]:
    """Load photographs with their cameras, at the size that ``method`` asks for.

    Prints how cameras were estimated; photographs that could not be placed are left out with a
    warning.

    Parameters
    ----------
    photos : sequence of str
        Photographs, or a folder of them. With ``cameras``, files that these list, or names of
        their views.
    cameras : path, optional
        Estimated from the photographs if left out.
    refine : bool
        Estimate given cameras anew, in the same world.
    method : Settings
    keyframes : int, optional
        Of more photographs, take so many (:func:`slgaussian.datasets.keyframes.choose_keyframes`).

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
        report(estimate)
        scene = unposed.posed(files, estimate)
        names = list(scene.cameras)
        places = {name: str(file.absolute()) for name, file in files.items()}
    else:
        scene, folder = posed_scene(cameras, photos)
        photos = _placed(scene, listed_photographs(scene, photos, folder), folder)
        names = [view_of(scene, photo, folder) for photo in photos]
        named = dict(zip(names, map(Path, photos), strict=True))
        if keyframes is not None:
            looks = [small(scene.read(name).image) for name in names]
            names = _keyframes(names, looks, keyframes, [scene.cameras[name] for name in names])
        files = {name: named[name] for name in names}
        places = {n: str(file.absolute()) if file.is_file() else n for n, file in files.items()}
        if refine:
            files = {name: file for name, file in files.items() if file.is_file()}
            scene, estimate = unposed.refined(scene, names, files)
            report(estimate)
            names = list(scene.cameras)
    sample = scene.sample(names, size=method.size, near=method.near, far=method.far)
    sample, left_out = usable(sample)
    for name, reason in left_out.items():
        print(f"warning: {name} is left out: {reason}", file=sys.stderr)
    return sample, places


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


def _placed(scene: Scene, photos: Sequence[str], folder: Path) -> list[str]:
    """Return the photographs without those left out when the scene's cameras were estimated."""
    left_out = {(folder / name).resolve(): reason for name, reason in scene.left_out.items()}
    placed = []
    for photo in photos:
        reason = left_out.get(Path(photo).resolve())
        if reason is None:
            placed.append(photo)
        else:
            print(
                f"warning: {photo} could not be placed when cameras were found, and is left out: "
                f"{reason}",
                file=sys.stderr,
            )
    return placed


def listed_photographs(scene: Scene, photos: Sequence[str], folder: Path) -> list[str]:
    """Return the photographs, in place of a folder those in it that have a camera.

    Raises
    ------
    InputError
        If none in a folder has.
    """
    listed: list[str] = []
    for photo in photos:
        if not Path(photo).is_dir():
            listed.append(photo)
            continue
        inside = [
            str(folder / name)
            for name in sorted(scene.cameras)
            if (folder / name).resolve().is_relative_to(Path(photo).resolve())
        ]
        if not inside:
            raise InputError(
                f"{photo}: none of the {len(scene.cameras)} photographs that have a camera lies in "
                f"this folder; they are in {folder}"
            )
        listed += inside
    return listed


def view_of(scene: Scene, photo: str, folder: Path) -> str:
    """Return the name that a scene, whose views are named from ``folder``, has for a photograph.

    Raises
    ------
    InputError
        If it has no camera for it.
    """
    place = Path(photo).resolve()
    for name in scene.cameras:
        listed = (folder / name).resolve()
        # A missing file is found too, and reading it then says what is missing.
        if listed in (place, place.with_suffix("")):
            return name
    if Path(photo).is_file():
        raise InputError(
            f"{photo}: no camera for this photograph; {folder} has cameras for "
            f"{len(scene.cameras)}, such as {', '.join(list(scene.cameras)[:4])}: give one of "
            "them, or add a camera"
        )
    return scene.find(photo)
