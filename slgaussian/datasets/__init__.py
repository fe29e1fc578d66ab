"""Dataset readers, one per format; each returns a Scene in the project's camera convention."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slgaussian.checks import namesakes
from slgaussian.components.registry import resolve
from slgaussian.errors import InputError

if TYPE_CHECKING:  # listing the formats must not wait for the import of OpenCV
    from slgaussian.datasets.training_set import TrainingSet
    from slgaussian.scene import Camera, Scene

__all__ = ["TrainingSet", "check_format", "inputs", "load", "scenes"]

READERS = {
    "nerfstudio": "slgaussian.datasets.nerfstudio:read",
    "colmap": "slgaussian.datasets.colmap:read",
    "llff": "slgaussian.datasets.llff:read",
    "npz": "slgaussian.datasets.npz:read",
    "lerf_ovs": "slgaussian.datasets.labelled_sets:read",
    "ovs3d": "slgaussian.datasets.labelled_sets:read",
    "re10k": "slgaussian.datasets.re10k:read",
    "photographs": "slgaussian.datasets.unposed:read",
    "stereo": "slgaussian.datasets.stereo:read",
    "procedural": "slgaussian.datasets.procedural.reader:read",
}

"""Reader of each format. Its module may have ``files``, which lists those of a scene that takes
long to read, and ``scenes``, which lists the scenes of a folder that may have several."""

FROM_FILES = tuple(name for name in READERS if name not in ("procedural", "stereo"))
"""Formats that are read from files; data of the other formats come with the program."""


def load(format: str, *args: Any, **settings: Any) -> Scene:
    """Read a scene with the reader of a format; the other arguments are passed to the reader.

    ``load("nerfstudio", "photos/")``, ``load("lerf_ovs", "lerf_ovs/", "figurines")``,
    ``load("re10k", "re10k/test", "5aca87f95a9412c6")``, ``load("procedural", seed=3)``; and
    ``load("photographs", "photos/")``, which estimates the cameras.

    Raises:
        InputError: If the format is unknown, its reader does not take these arguments or the data
            are invalid.
    """
    return _call(format, resolve("data format", READERS, format), *args, **settings)


def inputs(
    format: str, path: str | Path, views: Sequence[str], **settings: Any
) -> tuple[list[Path], dict[str, Camera]]:
    """Return the files and cameras on which views of a scene depend, without decoding photographs.

    The cameras reflect everything else that a reader depends on: those of LLFF depend on the names
    of all photographs, others on the size of the first existing photograph.

    Args:
        format, path, **settings: As in :func:`load`.
        views: sequence of str. Names as accepted by :meth:`slgaussian.scene.Scene.find`.

    Returns:
        files: list of Path. Files from which the views are read, possibly some more. Some may be
            missing.
        cameras: dict str -> Camera. Cameras of the views by full name; empty if they are determined
            by the files alone. Those of their namesakes (:func:`slgaussian.checks.namesakes`)
            follow.

    Raises:
        InputError: As :func:`load`, or if a view does not exist.
    """
    if format not in FROM_FILES:
        return [], {}
    if list_files := _find_listing(format, "files"):
        return _call(format, list_files, path, **settings), {}
    scene = load(format, path, **settings)
    names = [scene.find(name) for name in scene.with_cameras(views)]
    files = [file for name in names for file in scene.sources(name)]
    shared = [other for name in names for other in namesakes(name, scene.cameras)]
    return list(dict.fromkeys(files)), {name: scene.cameras[name] for name in (*names, *shared)}


def scenes(format: str, path: str | Path) -> dict[str, dict[str, Any]]:
    """List the scenes in a folder by name, each with the arguments of its reader.

    For formats with one scene per folder, the result is that scene, named after the folder.

    Raises:
        InputError: If the format is unknown or reads no folder, or the list of scenes cannot be
            read.
    """
    check_format(format)
    if list_scenes := _find_listing(format, "scenes"):
        return list_scenes(path)
    path = Path(path)
    folder = path if path.is_dir() else path.parent
    return {folder.resolve().name or "scene": {}}


def check_format(format: str) -> None:
    """Raise InputError, which lists the formats, unless the format reads a folder."""
    resolve("data format", READERS, format)
    if format not in FROM_FILES:
        expected = ", ".join(FROM_FILES)
        raise InputError(f"data format {format!r} reads no folder; expected {expected}")


def _find_listing(format: str, name: str) -> Callable[..., Any] | None:
    """Return the function ``files`` or ``scenes`` of the module of a format, if it has one."""
    module = sys.modules[resolve("data format", READERS, format).__module__]
    return getattr(module, name, None)


def _call(format: str, function: Callable[..., Any], *args: Any, **settings: Any) -> Any:
    """Call a function of a format; InputError if it does not take these arguments."""
    try:
        inspect.signature(function).bind(*args, **settings)
    except TypeError as error:
        takes = ", ".join(inspect.signature(function).parameters) or "nothing"
        raise InputError(f"data format {format!r}: {error}; it takes {takes}") from None
    return function(*args, **settings)


if not TYPE_CHECKING:  # which would find every name in a module with this function

    def __getattr__(name: str) -> Any:
        if name == "TrainingSet":  # torch takes seconds
            from slgaussian.datasets.training_set import TrainingSet

            return TrainingSet
        raise AttributeError(f"module 'slgaussian.datasets' has no attribute {name!r}")
