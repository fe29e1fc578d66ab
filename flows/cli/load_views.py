"""Cameras for the photographs of a command: given, found, or found anew."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from flows.cli.finding import tell
from flows.settings import Settings
from slgaussian.datasets import unposed
from slgaussian.datasets.keyframes import choose_keyframes
from slgaussian.datasets.recognise import posed_scene
from slgaussian.datasets.sharpness import blur, glance, small
from slgaussian.errors import InputError
from slgaussian.predict.links import usable
from slgaussian.scene import Sample, Scene


def posed_sample(
    photos: Sequence[str],
    cameras: Path | None,
    refine: bool,
    method: Settings,
    keyframes: int | None = None,
) -> tuple[Sample, dict[str, str]]:
    """The photographs with their cameras, at the size that ``method`` asks for.

    And which photographs these are, by their names: paths from the root or, where no file was
    given, names of views. All that were taken, also those that could not be placed.

    Of more than ``keyframes``, so many are taken
    (:func:`slgaussian.datasets.keyframes.choose_keyframes`).

    Without a place of cameras they are found, and how goes to standard error. With one, a
    photograph is a file that it lists, or the name of one of its views; ``refine`` finds their
    cameras anew, in the same world. Photographs that could not be placed are left out with a
    warning.

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
            kept = choose_keyframes([blur(look) for look in looks], keyframes)
            names = list(files)
            files = {names[k]: files[names[k]] for k in kept}
            _tell_keyframes(list(files), len(names))
        found = unposed.find(files)
        tell(found)
        scene = unposed.posed(files, found)
        names = list(scene.cameras)
        taken = {name: str(file.absolute()) for name, file in files.items()}
    else:
        scene, folder = posed_scene(cameras, photos)
        photos = _placed(scene, listed_photographs(scene, photos, folder), folder)
        names = [view_of(scene, photo, folder) for photo in photos]
        if keyframes is not None:
            among = [scene.cameras[name] for name in names]
            looks = [small(scene.read(name).image) for name in names]
            kept = choose_keyframes([blur(look) for look in looks], keyframes, among)
            names, photos = [names[k] for k in kept], [photos[k] for k in kept]
            _tell_keyframes(names, len(among))
        given = [(Path(photo), name) for photo, name in zip(photos, names, strict=True)]
        taken = {n: str(file.absolute()) if file.is_file() else n for file, n in given}
        if refine:
            files = {name: photo for photo, name in given if photo.is_file()}
            scene, found = unposed.refined(scene, names, files)
            tell(found)
            names = list(scene.cameras)
    sample = scene.sample(names, size=method.size, near=method.near, far=method.far)
    sample, left_out = usable(sample)
    for name, why in left_out.items():
        print(f"warning: {name} is left out: {why}", file=sys.stderr)
    return sample, taken


def _tell_keyframes(kept: Sequence[str], among: int) -> None:
    named = ", ".join(kept[:4]) + (", ..." if len(kept) > 4 else "")
    print(f"keyframes: {len(kept)} of {among} photographs, {named}", file=sys.stderr)


def _placed(scene: Scene, photos: Sequence[str], folder: Path) -> list[str]:
    """The photographs without those that were left out when the scene's cameras were found."""
    left = {(folder / name).resolve(): why for name, why in scene.left_out.items()}
    for photo in photos:
        why = left.get(Path(photo).resolve())
        if why is not None:
            print(
                f"warning: {photo} could not be placed when cameras were found, and is left out: "
                f"{why}",
                file=sys.stderr,
            )
    return [photo for photo in photos if Path(photo).resolve() not in left]


def listed_photographs(scene: Scene, photos: Sequence[str], folder: Path) -> list[str]:
    """The photographs, with those in place of a folder that lie in it and have a camera.

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
    """The name that a scene, whose views are named from ``folder``, has for a photograph.

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
