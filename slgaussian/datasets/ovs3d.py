"""3D-OVS: photographs, a COLMAP model or ``poses_bounds.npy``, and masks of every class.

A scene is a folder with ``images``, ``sparse`` or ``poses_bounds.npy`` or both, and
``segmentations`` with ``classes.txt`` and ``<view>/<class>.png``, read by
:mod:`slgaussian.benchmark.class_masks` (https://github.com/Kunhao-Liu/3D-OVS#datasets).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from slgaussian.datasets import colmap, llff
from slgaussian.datasets.lerf_ovs import find_scene
from slgaussian.errors import InputError, did_you_mean
from slgaussian.scene import Scene

LABELS = "segmentations"
"""Folder of the masks in that of a scene."""

CAMERAS = {"colmap": colmap, "llff": llff}


def read(path: str | Path, scene: str, cameras: str | None = None) -> Scene:
    """Read one scene.

    Parameters
    ----------
    path : path
        Folder of the whole set.
    scene : str
        A folder in it, such as bed.
    cameras : {"colmap", "llff"}, optional
        Where its cameras are from: the model in ``sparse`` if it is there, whatever else is, as
        that has the lens and the principal point; or ``poses_bounds.npy``, which 3D-OVS uses.

    Raises
    ------
    InputError
        If there is no such scene, or it cannot be read.
    """
    folder = find_scene(path, scene, scenes(path))
    if cameras is None:
        cameras = "colmap" if (folder / "sparse").is_dir() else "llff"
    if cameras not in CAMERAS:
        raise InputError(
            f"cameras: found {cameras!r}, expected one of {', '.join(CAMERAS)}"
            f"{did_you_mean(cameras, CAMERAS)}"
        )
    return CAMERAS[cameras].read(folder)


def scenes(path: str | Path) -> dict[str, dict[str, Any]]:
    """List the scenes of the set by name, each with what :func:`read` takes besides the path."""
    marks = ("sparse", llff.FILE)
    names = {folder.parent.name for mark in marks for folder in Path(path).glob(f"*/{mark}")}
    return {name: {"scene": name} for name in sorted(names)}
