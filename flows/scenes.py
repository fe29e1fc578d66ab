"""Scenes of a run: labelled sets, procedural rooms, and scenes of the demo."""

from __future__ import annotations

import re
from pathlib import Path

from flows.config import SceneSettings, Settings
from slgaussian import datasets
from slgaussian.benchmark.annotations import labelled_frames
from slgaussian.benchmark.index import ScenePair, read_index
from slgaussian.errors import InputError

DATASET = "procedural"
PATH_SUBDIVISIONS = 3
"""Subdivisions of each third of a room's camera path when views are swept: enough for eight."""
_SEEDS = re.compile(r"(\d+)(?:-(\d+))?")


def seeds(text: str, source: str) -> range:
    """Parse the seeds of ``"FIRST-LAST"``, inclusive, or of one number.

    Raises:
        InputError: If the text has another form or the range is empty; the message begins with
            ``source``.
    """
    match = _SEEDS.fullmatch(text)
    first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
    if first > last:
        raise InputError(f"{source}: found no seeds in {text!r}; expected FIRST-LAST, as 0-39")
    return range(first, last + 1)


def room_scene(seed: int, thirds: int = 1) -> SceneSettings:
    """Return a room of eight objects with two context views and two targets between them.

    Each third of the camera path is subdivided into ``thirds`` parts, which gives more views to
    choose from. The cameras of the four views stay the same, their noise and exposure do not.
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
    """Return the motorcycle stereo pair at original size and three rooms with novel views."""
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
    """Return the scenes of a labelled set by its index, and messages about omitted scenes.

    Clips of a published index that are not in the data are omitted. If labels are given, clips and
    targets without labels are omitted too.

    Raises:
        InputError: If the index cannot be read, its format is not the given one, or no scene is
            left.
    """
    if settings.data is None or settings.pairs is None:
        raise InputError("a labelled set needs data and pairs, and labels where it has none inside")
    index = read_index(settings.pairs)
    if index.format and settings.format and index.format != settings.format:
        raise InputError(
            f"{settings.pairs}: was made for data of format {index.format!r}, but format is "
            f"{settings.format!r}; leave it out"
        )
    if not index.format and settings.labels is None:
        raise InputError(f"{settings.pairs}: does not say where its labels are; give their folder")
    format = index.format or settings.format or "nerfstudio"
    messages = []
    if index.left_out:
        name, reason = next(iter(index.left_out.items()))
        messages.append(f"left out by the index: {len(index.left_out)}, such as {name}: {reason}")
    pairs = index.scenes
    if format == "re10k":
        available = datasets.scenes(format, settings.data)
        pairs = {n: pair for n, pair in pairs.items() if pair.options.get("key") in available}
        if len(pairs) < len(index.scenes):
            gone = len(index.scenes) - len(pairs)
            messages.append(f"not in {settings.data}: {gone} of the {len(index.scenes)} clips")
    tried = (_scene(*item, format, settings.data, settings.labels) for item in pairs.items())
    scenes = [scene for scene in tried if scene is not None]
    if len(scenes) < len(pairs):
        messages.append(
            f"without labels: {len(pairs) - len(scenes)} of the {len(pairs)} clips there"
        )
    if not scenes:
        raise InputError(f"{settings.pairs}: nothing of it can be scored ({'; '.join(messages)})")
    return scenes, messages


def _scene(
    name: str, pair: ScenePair, format: str, data: Path, label_folder: Path | None
) -> SceneSettings | None:
    """Return the scene of a pair; None if labels are given, but none for its targets."""
    targets, categories = list(pair.target), list(pair.categories or ())
    place = (label_folder or data) / pair.labels
    labels = place if categories or label_folder is not None else None
    if not categories and label_folder is not None:
        frames = labelled_frames(place) if place.exists() else {}
        targets = [name for name in targets if name in frames]
        categories = list(dict.fromkeys(c for name in targets for c in frames[name]))
        if not categories:
            return None
    return SceneSettings(
        name=name,
        dataset=find_data_folder(data).name,
        format=format,
        options=pair.options,
        path=data,
        context=list(pair.context),
        targets=targets,
        labels=labels,
        categories=categories,
    )


def find_data_folder(data: Path) -> Path:
    """Return the absolute folder of data, which may be given by a file in it, also by a link."""
    return (data.parent if data.is_file() else data).resolve()
