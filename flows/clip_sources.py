"""Sources of clips, such as folders of any format, chunks and rooms, and packing as chunks."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from flows.config import PackSettings
from flows.runners.progress import Progress
from flows.scenes import seeds
from slgaussian.datasets import colmap, re10k
from slgaussian.errors import InputError
from slgaussian.kernels import threads
from tasks.chunks import PosedFolder, Room
from tasks.context import StageEvent

ROOMS = "procedural:"
"""Prefix of a source of procedural rooms, followed by the first and last seed."""

_PLACED = re.compile(r"([\w .-]+)=(.+)")


@dataclass(frozen=True)
class Source:
    """One scene or one chunk of the sources.

    Attributes:
        location: As given by the user.
        holds: PosedFolder, Room or str. A scene, or the file or fsspec URL of a chunk.
        place: Name of the place that its clips show, if given.
    """

    location: str
    holds: PosedFolder | Room | str
    place: str = ""

    @property
    def name(self) -> str:
        """Name in tables: the clip's name for a scene, the file for a chunk."""
        return self.holds if isinstance(self.holds, str) else self.holds.name


def scenes_of(source: str, settings: PackSettings) -> list[PosedFolder | Room]:
    """Return the scenes of a source that is not a chunk.

    ``procedural:FIRST-LAST`` gives rooms, named ``procedural_FIRST`` and so on. Any other source is
    one scene named after its folder, which is read only later.

    Raises:
        InputError: If the seeds have another form.
    """
    if source.startswith(ROOMS):
        height, width = settings.size
        options = {
            "views": settings.views, "baseline": settings.baseline, "height": height,
            "width": width,
        }  # fmt: skip
        seed_range = seeds(source.removeprefix(ROOMS), source)
        return [Room(f"procedural_{seed}", {"seed": seed, **options}) for seed in seed_range]
    path = Path(source)
    # A scene is named after the folder above a camera file or a COLMAP model.
    folder = colmap.scene_folder((path.parent if path.is_file() else path).resolve())
    return [PosedFolder(folder.name, path)]


def sources_of(sources: Sequence[str], settings: PackSettings) -> list[Source]:
    """Return all scenes and chunks of the sources, in the given order.

    ``PLACE=SOURCE`` names the place that the clips of a source show.

    Raises:
        InputError: If a source does not exist, a folder of chunks cannot be listed, or two scenes
            or chunks have the same name.
    """
    by_name: dict[str, Source] = {}
    for source in _all(sources, settings):
        if source.name in by_name:
            raise InputError(
                f"{source.location}: its clip would be called {source.name!r}, as that of "
                f"{by_name[source.name].location} is; rename the folder, or leave one out"
            )
        by_name[source.name] = source
    return list(by_name.values())


def check_sources_exist(sources: Sequence[str]) -> None:
    """Raise InputError if a source that is a local file or folder does not exist."""
    for words in sources:
        source = _parted(words)[1]
        if not (is_chunks(source) or source.startswith(ROOMS) or Path(source).exists()):
            raise InputError(
                f"{source}: is not there; expected a folder of photographs, with cameras or "
                f"without, of chunks, or {ROOMS}FIRST-LAST"
            )


def _parted(words: str) -> tuple[str, str]:
    """Split ``PLACE=SOURCE`` into place, empty if not given, and source."""
    placed = None if Path(words).exists() else _PLACED.fullmatch(words)
    return (placed[1], placed[2]) if placed else ("", words)


def _all(sources: Sequence[str], settings: PackSettings) -> Iterator[Source]:
    check_sources_exist(sources)
    for words in sources:
        place, source = _parted(words)
        if is_chunks(source):
            folder = source.rstrip("/")
            if folder.endswith(CHUNK):
                yield Source(source, folder, place)
                continue
            chunks = re10k.chunk_names(folder)
            if not chunks:
                raise InputError(
                    f"{source}: has no chunk ({CHUNK}); `slgaussian ingest` makes chunks"
                )
            for chunk in chunks:
                yield Source(source, f"{folder}/{chunk}", place)
            continue
        for scene in scenes_of(source, settings):
            yield Source(source, scene, place)


CHUNK = ".torch"


def is_chunks(source: str) -> bool:
    """Return whether a source is a chunk, or a folder or URL of chunks."""
    path = Path(source)
    return (
        "://" in source or source.endswith(CHUNK) or (path.is_dir() and any(path.glob(f"*{CHUNK}")))
    )


@dataclass
class Packed:
    """Written chunks, their number of clips, and reasons of the clips that were left out."""

    chunks: list[str] = field(default_factory=list)
    clips: int = 0
    left_out: list[str] = field(default_factory=list)


def pack(sources: Sequence[str], out: Path, settings: PackSettings) -> Packed:
    """Add every source as one clip to the folder of chunks ``out``, in new chunks.

    Clips that the folder already has are skipped. A source is left out if it or one of its views
    cannot be read.

    Args:
        sources: sequence of str. Sources of :func:`sources_of`, but no chunks.

    Raises:
        InputError: If a source is invalid, two have the same name, or the folder cannot be written.
    """
    existing = re10k.read_index(out) if (out / re10k.INDEX).exists() else {}
    scenes = [
        source.holds for source in sources_of(sources, settings) if source.name not in existing
    ]
    packed = Packed()
    if not scenes:
        return packed
    threads.limit()

    def clips() -> Iterator[re10k.Clip]:
        for scene in scenes:
            assert not isinstance(scene, str)  # not a chunk
            start = time.perf_counter()
            progress.update(StageEvent(scene.name, "pack", "running"))
            try:
                clip = re10k.clip_of(scene.scene())
            except InputError as error:
                packed.left_out.append(str(error))
                progress.update(StageEvent(scene.name, "pack", "failed", str(error)))
                continue
            seconds = time.perf_counter() - start
            progress.update(StageEvent(scene.name, "pack", "completed", seconds=seconds))
            packed.clips += 1
            yield clip

    with Progress(len(scenes), 1) as progress:
        packed.chunks = re10k.write(out, clips(), int(settings.chunk_mb * 1e6))
    return packed
