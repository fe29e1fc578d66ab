"""LERF-OVS, the scenes of LERF that LangSplat labelled: COLMAP folders and labelled frames.

The folder has one with ``images`` and ``sparse/0`` for each scene, and ``label``, in which
``<scene>/<frame>.json`` is read by :mod:`slgaussian.benchmark.annotations`. In LangSplat the
labelled frames are training views; here they are held out.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from slgaussian.datasets import colmap
from slgaussian.errors import InputError
from slgaussian.scene import Scene

LABELS = "label"
"""Folder of the labels, in it one a scene."""


def read(path: str | Path, scene: str) -> Scene:
    """Read one scene as :func:`slgaussian.datasets.colmap.read` does.

    Parameters
    ----------
    path : path
        Folder of the whole set.
    scene : str
        A folder in it, such as figurines.

    Raises
    ------
    InputError
        If there is no such scene, or it cannot be read.
    """
    return colmap.read(find_scene(path, scene, scenes(path)))


def scenes(path: str | Path) -> dict[str, dict[str, Any]]:
    """List the scenes of the set by name, each with what :func:`read` takes besides the path."""
    names = sorted(folder.parent.name for folder in Path(path).glob("*/sparse"))
    return {name: {"scene": name} for name in names}


def find_scene(path: str | Path, scene: str, known: dict[str, Any]) -> Path:
    """Return the folder of a scene; InputError if it is not among those known."""
    if scene not in known:
        raise InputError(
            f"{path}: has no scene {scene!r}; found {', '.join(known) or 'none'} (give the folder "
            "of the whole set)"
        )
    return Path(path) / scene
