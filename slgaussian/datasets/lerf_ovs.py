"""LERF-OVS, the scenes of LERF that LangSplat labelled: COLMAP folders and labelled frames.

The folder has one with ``images`` and ``sparse/0`` for each scene, and ``label``, in which
``<scene>/<frame>.json`` is read by :mod:`slgaussian.benchmark.annotations`. In LangSplat the
labelled frames are training views; here they are held out.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from slgaussian.datasets import colmap
from slgaussian.datasets.labelled_scene import LabelledScene
from slgaussian.errors import InputError
from slgaussian.scene import Scene

LABELS = "label"
"""Folder of the labels, in it one a scene."""

PUBLISHED = {
    scene: LabelledScene(tuple(f"frame_{n:05d}" for n in numbers), texts, size)
    for scene, (numbers, size, texts) in {
        "figurines": (
            (41, 105, 152, 195),
            (986, 728),
            (
                "jake", "pirate hat", "pikachu", "rubber duck with hat", "porcelain hand",
                "red apple", "tesla door handle", "waldo", "bag", "toy cat statue", "miffy",
                "green apple", "pumpkin", "rubics cube", "old camera", "rubber duck with buoy",
                "red toy chair", "pink ice cream", "spatula", "green toy chair", "toy elephant",
            ),
        ),
        "ramen": (
            (6, 24, 60, 65, 81, 119, 128),
            (988, 731),
            (
                "nori", "sake cup", "kamaboko", "corn", "spoon", "egg", "onion segments", "plate",
                "napkin", "bowl", "glass of water", "hand", "chopsticks", "wavy noodles",
            ),
        ),
        "teatime": (
            (2, 25, 43, 107, 129, 140),
            (988, 730),
            (
                "sheep", "yellow pouf", "stuffed bear", "coffee mug", "tea in a glass", "apple",
                "coffee", "hooves", "bear nose", "dall-e brand", "plate", "paper napkin",
                "three cookies", "bag of cookies",
            ),
        ),
        "waldo_kitchen": (
            (53, 66, 89, 140, 154),
            (985, 725),
            (
                "Stainless steel pots", "dark cup", "refrigerator", "frog cup", "pot", "spatula",
                "plate", "spoon", "toaster", "ottolenghi", "plastic ladle", "sink", "ketchup",
                "cabinet", "red cup", "pour-over vessel", "knife", "yellow desk",
            ),
        ),
    }.items()
}  # fmt: skip
"""The published scenes: labelled frames and texts as OpenGaussian's evaluation lists them
(https://github.com/yanmin-wu/OpenGaussian), sizes as their label files have them."""


def labelled(scene: str) -> list[str]:
    """Names of the labelled frames of a published scene; none of another."""
    return list(PUBLISHED[scene].frames) if scene in PUBLISHED else []


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
    """The scenes of the set by name, each with what :func:`read` takes besides the path."""
    found = sorted(folder.parent.name for folder in Path(path).glob("*/sparse"))
    return {name: {"scene": name} for name in found}


def find_scene(path: str | Path, scene: str, known: dict[str, Any]) -> Path:
    """The folder of a scene; InputError if it is not among those known."""
    if scene not in known:
        raise InputError(
            f"{path}: has no scene {scene!r}; found {', '.join(known) or 'none'} (give the folder "
            "of the whole set)"
        )
    return Path(path) / scene
