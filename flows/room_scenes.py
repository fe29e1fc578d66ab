"""Made-up rooms as scenes: asked for by their seeds, so many as anybody wants."""

from __future__ import annotations

import re

from flows.settings import SceneSettings
from slgaussian.errors import InputError

DATASET = "procedural"
_SEEDS = re.compile(r"(\d+)(?:-(\d+))?")


def seeds(text: str, source: str) -> range:
    """The seeds of ``"FIRST-LAST"``, both included, or of one number.

    Raises
    ------
    InputError
        If it is neither, or there is none; the sentence begins with ``source``.
    """
    found = _SEEDS.fullmatch(text)
    first, last = (int(found[1]), int(found[2] or found[1])) if found else (1, 0)
    if first > last:
        raise InputError(f"{source}: found no seeds in {text!r}; expected FIRST-LAST, as 0-39")
    return range(first, last + 1)


def room_scene(seed: int) -> SceneSettings:
    """A room of eight objects, seen from two places, asked from two between them."""
    return SceneSettings(
        name=f"room_{seed}",
        dataset=DATASET,
        format="procedural",
        options={"seed": seed, "objects": 8, "views": 4},
        context=["view_00", "view_03"],
        targets=["view_01", "view_02"],
    )
