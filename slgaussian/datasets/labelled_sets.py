"""The labelled sets LERF-OVS and 3D-OVS: folders of scenes, with texts and masks of some views.

LERF-OVS are the scenes of LERF that LangSplat labelled: a folder with ``images`` and ``sparse/0``
for each scene, and ``label/<scene>/<frame>.json``, read by :mod:`slgaussian.benchmark.annotations`.
In LangSplat the labelled frames are training views; here they are held out.

A scene of 3D-OVS (https://github.com/Kunhao-Liu/3D-OVS#datasets) is a folder with ``images``,
``sparse`` or ``poses_bounds.npy`` or both, and ``segmentations`` with ``classes.txt`` and
``<view>/<class>.png``, read by :mod:`slgaussian.benchmark.annotations`.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from slgaussian.datasets import colmap, llff
from slgaussian.errors import InputError
from slgaussian.scene import Scene

LABELS = {"lerf_ovs": "label/{scene}", "ovs3d": "{scene}/segmentations"}
"""Folder of a scene's labels, relative to the folder of the set, by format."""

PUBLISHED = {
    "lerf_ovs": {
        "figurines": "00041 00105 00152 00195",
        "ramen": "00006 00024 00060 00065 00081 00119 00128",
        "teatime": "00002 00025 00043 00107 00129 00140",
        "waldo_kitchen": "00053 00066 00089 00140 00154",
    },
    "ovs3d": {
        "bed": "00 04 10 23 30",
        "bench": "02 05 25 27 32",
        "blue_sofa": "03 05 13 24 27",
        "covered_desk": "00 01 11 26 29",
        "lawn": "01 03 09 13 29",
    },
}
"""Labelled frames of the published scenes, by format and scene; in LERF-OVS after ``frame_``.
LERF-OVS is evaluated so by OpenGaussian (https://github.com/yanmin-wu/OpenGaussian); of 3D-OVS
these are the scenes of the paper's table 2, with the views that have masks in other evaluations."""


def read(path: str | Path, scene: str) -> Scene:
    """Read one scene of a set.

    The cameras are those of the COLMAP model in ``sparse`` if it exists, because it has the lens
    and the principal point; else those of ``poses_bounds.npy``, which 3D-OVS uses.

    Args:
        path: Folder of the whole set.
        scene: A folder in it, such as figurines.

    Raises:
        InputError: If there is no such scene, or it cannot be read.
    """
    if scene not in (names := scenes(path)):
        raise InputError(
            f"{path}: has no scene {scene!r}; found {', '.join(names) or 'none'} (give the folder "
            "of the whole set)"
        )
    folder = Path(path) / scene
    return (colmap if (folder / "sparse").is_dir() else llff).read(folder)


def scenes(path: str | Path) -> dict[str, dict[str, Any]]:
    """List the scenes of a set by name, with the arguments of :func:`read` besides the path."""
    marks = ("sparse", llff.FILE)
    names = {inside.parent.name for mark in marks for inside in Path(path).glob(f"*/{mark}")}
    return {name: {"scene": name} for name in sorted(names)}


def is_published(format: str, scene: str, frames: Iterable[str]) -> bool:
    """Return whether a scene has the name and the labelled frames of a published scene."""
    published = PUBLISHED.get(format, {}).get(scene, "").split()
    prefix = "frame_" if format == "lerf_ovs" else ""
    return bool(published) and set(frames) == {prefix + frame for frame in published}
