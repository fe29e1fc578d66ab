"""Scenes of any kind as chunks, so that they run the very path that a published corpus does."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from flows.corpus_settings import PackSettings
from flows.room_scenes import seeds
from flows.runners.progress import Progress
from slgaussian import datasets
from slgaussian.datasets import nerfstudio, re10k
from slgaussian.datasets.recognise import posed_scene
from slgaussian.errors import InputError
from slgaussian.kernels import threads
from slgaussian.scene import Scene
from tasks.events import Failed, Finished, Started

ROOMS = "procedural:"
"""How made-up rooms are asked for, with their first and last seed after it."""


@dataclass
class Packed:
    """The chunks that were written, how many clips are in them, and why others are not."""

    chunks: list[str] = field(default_factory=list)
    clips: int = 0
    left_out: list[str] = field(default_factory=list)


def pack(sources: Sequence[str], out: Path, settings: PackSettings) -> Packed:
    """Add every source as one clip to the folder of chunks ``out``, in new chunks.

    A source that cannot be read, or of which a view cannot, is left out by itself.

    Parameters
    ----------
    sources : sequence of str
        Folders or files of cameras of any format that is known, or folders of photographs alone,
        whose cameras are found; the clip is called as the folder. And ``procedural:FIRST-LAST`` for
        the rooms of these seeds, ``procedural_FIRST`` and so on.
    out : path
    settings : PackSettings

    Raises
    ------
    InputError
        If a source has no such form, two have one name, a name is in the folder already, or the
        folder cannot be written.
    """
    scenes = dict(_scenes(sources, settings))
    if (out / re10k.INDEX).exists():
        taken = sorted(scenes.keys() & re10k.read_index(out).keys())
        if taken:
            more = f" and {len(taken) - 1} more" if taken[1:] else ""
            raise InputError(
                f"{out}: has a clip {taken[0]!r}{more} already; leave it out, or choose another "
                "folder with -o"
            )
    threads.limit()
    packed = Packed()
    with Progress(len(scenes), 1) as progress:
        clips = _clips(scenes, progress, packed)
        packed.chunks = re10k.write(out, clips, int(settings.chunk_mb * 1e6))
    progress.summary()
    return packed


def _clips(
    scenes: dict[str, Callable[[], Scene]], progress: Progress, packed: Packed
) -> Iterator[re10k.Clip]:
    for name, load in scenes.items():
        start = time.perf_counter()
        progress.hear(Started(name, "pack"))
        try:
            clip = re10k.clip_of(load())
        except InputError as error:
            packed.left_out.append(str(error))
            progress.hear(Failed(name, "pack", str(error)))
            continue
        progress.hear(Finished(name, "pack", time.perf_counter() - start, cached=False))
        packed.clips += 1
        yield clip


def _scenes(
    sources: Sequence[str], settings: PackSettings
) -> Iterator[tuple[str, Callable[[], Scene]]]:
    seen: dict[str, str] = {}
    for source in sources:
        if source.startswith(ROOMS):
            asked = seeds(source.removeprefix(ROOMS), source)
            named = {f"procedural_{seed}": _room(seed, settings) for seed in asked}
        else:
            path = Path(source)
            folder = path.parent if path.name == nerfstudio.FILE else path
            named = {folder.resolve().name: partial(_posed, path)}
        for name, load in named.items():
            if name in seen:
                raise InputError(
                    f"{source}: its clip would be called {name!r}, as that of {seen[name]} is; "
                    "rename the folder, or leave one out"
                )
            seen[name] = source
            yield name, load


def _posed(path: Path) -> Scene:
    return posed_scene(path)[0]


def _room(seed: int, settings: PackSettings) -> Callable[[], Scene]:
    height, width = settings.size
    return lambda: datasets.load(
        "procedural",
        seed=seed,
        views=settings.views,
        baseline=settings.baseline,
        height=height,
        width=width,
    )
