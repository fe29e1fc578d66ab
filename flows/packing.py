"""Scenes of any kind as chunks, so that they run the very path that a published corpus does."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from flows.clip_sources import scenes_of
from flows.corpus_settings import PackSettings
from flows.runners.progress import Progress
from slgaussian.datasets import re10k
from slgaussian.errors import InputError
from slgaussian.kernels import threads
from tasks.context import StageEvent
from tasks.packed import PosedFolder, Room


@dataclass
class Packed:
    """The chunks that were written, how many clips are in them, and why others are not."""

    chunks: list[str] = field(default_factory=list)
    clips: int = 0
    left_out: list[str] = field(default_factory=list)


def pack(sources: Sequence[str], out: Path, settings: PackSettings) -> Packed:
    """Add every source as one clip to the folder of chunks ``out``, in new chunks.

    A clip whose name is there already is left as it is. A source that cannot be read, or of which a
    view cannot, is left out by itself.

    Parameters
    ----------
    sources : sequence of str
        As :func:`flows.clip_sources.scenes_of` takes them.
    out : path
    settings : PackSettings

    Raises
    ------
    InputError
        If a source has no such form, two have one name, or the folder cannot be written.
    """
    there = re10k.read_index(out) if (out / re10k.INDEX).exists() else {}
    scenes = {k: scene for k, scene in _scenes(sources, settings).items() if k not in there}
    if not scenes:
        return Packed()
    threads.limit()
    packed = Packed()
    with Progress(len(scenes), 1) as progress:
        clips = _clips(scenes, progress, packed)
        packed.chunks = re10k.write(out, clips, int(settings.chunk_mb * 1e6))
    progress.summary()
    return packed


def _clips(
    scenes: dict[str, PosedFolder | Room], progress: Progress, packed: Packed
) -> Iterator[re10k.Clip]:
    for name, source in scenes.items():
        start = time.perf_counter()
        progress.update(StageEvent(name, "pack", "running"))
        try:
            clip = re10k.clip_of(source.scene(), source.url())
        except InputError as error:
            packed.left_out.append(str(error))
            progress.update(StageEvent(name, "pack", "failed", str(error)))
            continue
        seconds = time.perf_counter() - start
        progress.update(StageEvent(name, "pack", "completed", seconds=seconds))
        packed.clips += 1
        yield clip


def _scenes(sources: Sequence[str], settings: PackSettings) -> dict[str, PosedFolder | Room]:
    found: dict[str, PosedFolder | Room] = {}
    seen: dict[str, str] = {}
    for source in sources:
        for scene in scenes_of(source, settings):
            if scene.name in seen:
                raise InputError(
                    f"{source}: its clip would be called {scene.name!r}, as that of "
                    f"{seen[scene.name]} is; rename the folder, or leave one out"
                )
            seen[scene.name] = source
            found[scene.name] = scene
    return found
