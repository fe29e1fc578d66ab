"""Made-up rooms as scenes: asked for by their seeds, so many as anybody wants."""

from __future__ import annotations

import re

from flows.settings import SceneSettings
from slgaussian.errors import InputError

DATASET = "procedural"
THIRDS = 3
"""Into how many parts thirds of the way are parted where views are added: enough for eight."""
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


def room_scene(seed: int, thirds: int = 1) -> SceneSettings:
    """A room of eight objects, seen from two places, asked from two between them.

    Each third of the way between the two is parted into ``thirds``, so that there are further views
    to choose from; the cameras of those four are the same, their noise and exposure are not.
    """
    first, *targets, last = (f"view_{k * thirds:02d}" for k in range(4))
    return SceneSettings(
        name=f"room_{seed}",
        dataset=DATASET,
        format="procedural",
        options={"seed": seed, "objects": 8, "views": 3 * thirds + 1},
        context=[first, last],
        targets=targets,
    )
