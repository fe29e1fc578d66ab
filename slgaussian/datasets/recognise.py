"""Recognition of the camera format of a path from file names and first bytes, and its reading."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from slgaussian.datasets import colmap, llff, nerfstudio, npz, unposed
from slgaussian.datasets.photographs import image_folder, list_photographs
from slgaussian.errors import InputError
from slgaussian.formats.depth_maps import numbered_views
from slgaussian.scene import Camera, Scene

EXPECTED = (
    f"{nerfstudio.FILE} or another JSON file of nerfstudio's form, {llff.FILE}, a COLMAP model "
    "(cameras and images, .bin or .txt, as in sparse/0), an NPZ with depth and cameras, or the "
    "folder of a scene that holds one of them"
)


def posed_scene(path: str | Path, photographs: Sequence[str] = ()) -> tuple[Scene, Path]:
    """Read the scene at ``path``; also return the folder relative to which its views are named.

    For a folder of photographs without cameras, the cameras are estimated.

    Args:
        path: File or folder, see :data:`EXPECTED`.
        photographs: sequence of str. Photographs, or folders, whose views are needed. For COLMAP
            and LLFF they may be outside the scene's folder ``images``.

    Raises:
        InputError: If there are no cameras of a known format, or they cannot be read.
    """
    format, place = recognise(Path(path))
    if format == "photographs":
        listed = unposed.name_files([place])
        return unposed.read_with_cameras(listed, unposed.find(listed)), unposed.find_folder(listed)
    if format == "nerfstudio":
        return nerfstudio.read(place), place if place.is_dir() else place.parent
    if format == "npz":
        existing = [photo for photo in photographs if Path(photo).exists()] or [str(place.parent)]
        return npz.read(place, existing), unposed.find_folder(unposed.name_files(existing))
    reader = {"colmap": colmap, "llff": llff}[format]
    scene = place if place.is_dir() else place.parent
    folder = image_folder(colmap.scene_folder(scene) if reader is colmap else scene).resolve()
    files = [
        file.resolve()
        for place in map(Path, photographs)
        for file in (list_photographs(place) if place.is_dir() else [place])
        if file.is_file()
    ]
    if not files or any(file.is_relative_to(folder) for file in files):
        return reader.read(place, str(folder)), folder
    common = unposed.find_folder(dict(enumerate(files)))
    read = reader.read(place, str(common))
    # A model may name its photographs from a folder above, and with other extensions.
    stems = {os.path.splitext(file)[0] for file in files}
    for above in (common, *common.parents):
        if any(os.path.splitext(above / name)[0] in stems for name in read.cameras):
            return (read if above == common else reader.read(place, str(above))), above
    return read, common


def cameras_in(path: str | Path) -> Mapping[str, Camera]:
    """Read the cameras at ``path`` by name, in the formats of :func:`posed_scene`.

    Photographs are not needed if the format contains their size and names, as all except LLFF do.

    Raises:
        InputError: As :func:`posed_scene`, and if there are only photographs.
    """
    format, place = recognise(Path(path))
    if format == "photographs":
        raise InputError(f"{path}: holds photographs and no cameras; expected {EXPECTED}")
    if format == "nerfstudio":
        return nerfstudio.read_cameras(place)
    return posed_scene(path)[0].cameras


def recognise(path: Path) -> tuple[str, Path]:
    """Return the format of the cameras in a file or folder, and the path for its reader.

    Raises:
        InputError: If there are no cameras in a known format.
    """
    if path.is_dir():
        if (path / nerfstudio.FILE).is_file():
            return "nerfstudio", path
        if colmap.models_in(path):
            return "colmap", _find_scene(path)
        if (path / llff.FILE).is_file():
            return "llff", path
        if numbered_views(path):
            return "npz", path
        json_files = sorted(file.name for file in path.glob("*.json"))
        if list_photographs(path) and not json_files:
            return "photographs", path
        names = json_files or sorted(inside.name for inside in path.iterdir())
        raise InputError(
            f"{path}: holds no cameras but {', '.join(names[:4]) or 'nothing'}; expected {EXPECTED}"
        )
    try:
        with path.open("rb") as file:
            start = file.read(64)
    except OSError as bad:
        raise InputError(f"{path}: cannot be read ({bad.strerror}); expected {EXPECTED}") from None
    if start.startswith(b"\x93NUMPY") or path.suffix == ".npy":
        return "llff", path
    if start.startswith(b"PK\x03\x04") or path.suffix == ".npz":
        return "npz", path
    if path in colmap.model_files(path.parent):
        return "colmap", _find_scene(path.parent)
    if start.lstrip(b"\xef\xbb\xbf \t\r\n").startswith((b"{", b"[")) or path.suffix == ".json":
        return "nerfstudio", path
    raise InputError(f"{path}: is no file of cameras; expected {EXPECTED}")


def _find_scene(path: Path) -> Path:
    """Return the scene's folder if its reader would use the model in ``path``; else ``path``."""
    scene = colmap.scene_folder(path)
    model, usual = (colmap.largest(colmap.models_in(place)) for place in (path, scene))
    return scene if model.resolve() == usual.resolve() else path
