"""The scenes of a run: of a labelled set, made-up rooms, those of the demo, and listed ones."""

from __future__ import annotations

import re
from pathlib import Path

from flows.config import SceneSettings, Settings
from slgaussian import datasets
from slgaussian.benchmark.annotations import labelled_frames
from slgaussian.benchmark.index import ScenePair, read_index
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
    match = _SEEDS.fullmatch(text)
    first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
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


ROOMS = (0, 1, 2)
"""Seeds of the procedural rooms."""


def demo_scenes() -> list[SceneSettings]:
    """The motorcycle stereo pair at its own size and three procedural rooms with novel views."""
    motorcycle = SceneSettings(
        name="motorcycle",
        dataset="stereo",
        format="stereo",
        context=["left", "right"],
        size="original",
        queries=["red", "black", "brown wood", "grey metal", "white wall", "grey floor"],
    )
    return [motorcycle, *map(room_scene, ROOMS)]


def labelled_scenes(settings: Settings) -> tuple[list[SceneSettings], list[str]]:
    """The scenes of a labelled set as its index lists them, and what is to be said of the others.

    Clips of a published index that are not in the data, and, where labels are given, those without,
    are left out; of the others the targets that are labelled.

    Raises
    ------
    InputError
        If the index cannot be read, its format is not the given one, or nothing of it is there.
    """
    if settings.data is None or settings.pairs is None:
        raise InputError("a labelled set needs data and pairs, and labels where it has none inside")
    index = read_index(settings.pairs)
    if index.format and settings.format and index.format != settings.format:
        raise InputError(
            f"{settings.pairs}: was made for data of format {index.format!r}, but format is "
            f"{settings.format!r}; leave it out"
        )
    if index.format is None and settings.labels is None:
        raise InputError(f"{settings.pairs}: does not say where its labels are; give their folder")
    format = index.format or settings.format or "nerfstudio"
    messages = []
    if index.left_out:
        name, reason = next(iter(index.left_out.items()))
        messages.append(f"left out by the index: {len(index.left_out)}, such as {name}: {reason}")
    pairs = index.pairs
    if format == "re10k":
        available = datasets.scenes(format, settings.data)
        pairs = tuple(pair for pair in pairs if pair.options.get("key") in available)
        if len(pairs) < len(index.pairs):
            gone = len(index.pairs) - len(pairs)
            messages.append(f"not in {settings.data}: {gone} of the {len(index.pairs)} clips")
    tried = (_scene(pair, format, settings.data, settings.labels) for pair in pairs)
    scenes = [scene for scene in tried if scene is not None]
    if len(scenes) < len(pairs):
        messages.append(
            f"without labels: {len(pairs) - len(scenes)} of the {len(pairs)} clips there"
        )
    if not scenes:
        raise InputError(f"{settings.pairs}: nothing of it can be scored ({'; '.join(messages)})")
    return scenes, messages


def _scene(
    pair: ScenePair, format: str, data: Path, label_folder: Path | None
) -> SceneSettings | None:
    """The scene of a pair; None if labels are given, but none of what it asks is labelled."""
    targets, categories = list(pair.targets), list(pair.categories)
    place = (label_folder or data) / pair.labels
    labels = place if categories or label_folder is not None else None
    if not categories and label_folder is not None:
        frames = labelled_frames(place) if place.is_dir() else {}
        targets = [name for name in targets if name in frames]
        categories = list(dict.fromkeys(c for name in targets for c in frames[name]))
        if not categories:
            return None
    folder = data.resolve()
    folder = folder.parent if folder.is_file() else folder
    return SceneSettings(
        name=pair.scene,
        dataset=folder.name,
        format=format,
        options=dict(pair.options),
        path=data,
        context=list(pair.context),
        targets=targets,
        labels=labels,
        categories=categories,
    )
