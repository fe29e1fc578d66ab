"""Sources of clips: folders of any format, chunks and procedural rooms.

A chunk or a scene is the unit of work, of memory, of caching and of failure. Both are identified by
their content, so a second run reads only new ones.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flows.config import CorpusSettings
from flows.runners.batches import Failure, SceneTask, map_scenes
from flows.runners.progress import Progress
from flows.runners.task_runners import Workers
from flows.scenes import find_data_folder, seeds
from slgaussian.datasets import colmap, re10k
from slgaussian.datasets.configs import Bounds
from slgaussian.datasets.sources import PosedFolder, Room
from slgaussian.errors import InputError
from slgaussian.io import KnownFile
from slgaussian.storage.store import ArtifactRef
from tasks.chunks import known_chunk, packed, pairs, views
from tasks.context import current_run

ROOMS_PREFIX = "procedural:"
"""Prefix of a source of procedural rooms, followed by the first and last seed."""

ROOM_OPTIONS = {"views": 12, "baseline": 1.2, "height": 360, "width": 640}
"""Options of a procedural room; metres from the first to the last view on an arc of 3.3 m."""

CHUNK_SUFFIX = ".torch"

_PLACE_PATTERN = re.compile(r"([\w .-]+)=(.+)")


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
        """Name in tables: the clip's name for a scene, folder and file for a chunk."""
        if isinstance(self.holds, str):
            return "/".join(Path(self.holds).parts[-2:])
        return self.holds.name

    @property
    def title(self) -> str:
        """Name of all that was given as one source, without folders of the machine."""
        is_path = ":" not in self.location.partition("/")[0]
        return Path(self.location).resolve().name if is_path else self.location


def find_sources(texts: Sequence[str]) -> list[Source]:
    """Return all scenes and chunks of the sources, in the given order.

    ``procedural:FIRST-LAST`` gives rooms, named ``procedural_FIRST`` and so on. Any other source
    that is no chunk is one scene named after its folder, which is read only later.
    ``PLACE=SOURCE`` names the place that the clips of a source show.

    Raises:
        InputError: If a source does not exist, a folder of chunks cannot be listed, or two scenes
            or chunks have the same name.
    """
    by_name: dict[str, Source] = {}
    for text in texts:
        placed = None if Path(text).exists() else _PLACE_PATTERN.fullmatch(text)
        place, location = placed.groups() if placed else ("", text)
        for holds in _contents(location):
            source = Source(location, holds, place)
            if (earlier := by_name.setdefault(source.name, source)) is not source:
                raise InputError(
                    f"{location}: its clip would be called {source.name!r}, as that of "
                    f"{earlier.location} is; rename the folder, or leave one out"
                )
    return list(by_name.values())


def _contents(location: str) -> Iterable[PosedFolder | Room | str]:
    """Return the rooms, chunks or scenes at a location."""
    if location.startswith(ROOMS_PREFIX):
        seed_range = seeds(location.removeprefix(ROOMS_PREFIX), location)
        return [Room(f"procedural_{seed}", {"seed": seed, **ROOM_OPTIONS}) for seed in seed_range]
    path, folder = Path(location), location.rstrip("/")
    if folder.endswith(CHUNK_SUFFIX):
        return [folder]
    if "://" in location or (path.is_dir() and any(path.glob(f"*{CHUNK_SUFFIX}"))):
        chunks = re10k.chunk_names(folder)
        if not chunks:
            raise InputError(
                f"{location}: has no chunk ({CHUNK_SUFFIX}); `slgaussian ingest` makes chunks"
            )
        return [f"{folder}/{chunk}" for chunk in chunks]
    if not path.exists():
        raise InputError(
            f"{location}: is not there; expected a folder of photographs, with cameras or without, "
            f"of chunks, or {ROOMS_PREFIX}FIRST-LAST"
        )
    # A scene is named after the folder above a camera file or a COLMAP model.
    scene_folder = colmap.scene_folder(find_data_folder(path))
    return [PosedFolder(scene_folder.name, path)]


@dataclass(frozen=True)
class Clips:
    """Results of all sources.

    Attributes:
        sources: All sources by name.
        refs: Refs by source and stage, in the order of the sources.
        owners: Source of each clip that may be used: the first one that has it.
        failures: Sources, clips and samples that were left out.
    """

    sources: Mapping[str, Source]
    refs: Mapping[str, Mapping[str, ArtifactRef]]
    owners: Mapping[str, str]
    failures: list[Failure]


def source_tasks(
    sources: Iterable[Source], pipeline: Callable[..., object], arguments: tuple[Any, ...]
) -> list[SceneTask]:
    """Return the tasks of a pipeline on sources; arguments as in :func:`map_sources`."""
    tasks = []
    for source in sources:
        first = views if isinstance(source.holds, str) else packed
        tasks.append(SceneTask(source.name, pipeline, (source.holds, *arguments), first.name))
    return tasks


def map_sources(
    config: CorpusSettings,
    workers: Workers,
    pipeline: Callable[..., object],
    arguments: tuple[Any, ...],
    stages: int,
    verbose: bool,
) -> Clips:
    """Run a pipeline of a number of stages on all sources.

    It is called with the content of a source and ``arguments``. Scenes have one more stage, packing
    as a chunk. Withdrawn clips have no owner.
    """
    sources, withdrawn = find_sources(config.sources), config.withdrawn_clips()
    computed, failures = dict[str, dict[str, ArtifactRef]](), list[Failure]()
    for unit, first, extra in (("chunks", views, 0), ("scenes", packed, 1)):
        tasks = [t for t in source_tasks(sources, pipeline, arguments) if t.first == first.name]
        progress = Progress(len(tasks), stages + extra, verbose, unit=unit)
        outcome = map_scenes(tasks, workers, progress)
        computed |= outcome.refs
        failures += outcome.failures
    refs = {s.name: computed[s.name] for s in sources if s.name in computed}
    owners = dict[str, str]()
    for name, stage_refs in refs.items():
        for stage, ref in stage_refs.items():
            failures += [Failure(stage=stage, **bad) for bad in ref.meta.get("left_out", ())]
        for clip in workers.store.get(stage_refs[views.name])["clip"].unique().to_pylist():
            if owners.setdefault(clip, name) != name:
                reason = f"clip {clip!r} of {name} is also in {owners[clip]}, which is used"
                failures.append(Failure(clip, views.name, "InputError", reason))
    failures = [failure for failure in failures if failure.scene not in withdrawn]
    owners = {clip: name for clip, name in owners.items() if clip not in withdrawn}
    return Clips({source.name: source for source in sources}, refs, owners, failures)


def choose_samples(
    holds: PosedFolder | Room | str, bounds: Bounds, trust_cameras: bool, targets: int
) -> tuple[KnownFile | ArtifactRef, ArtifactRef]:
    """Run the pipeline from a source to the choice of its samples; return chunk and ``pairs``."""
    if isinstance(holds, str):
        chunk: KnownFile | ArtifactRef = known_chunk(current_run().store, holds)
    else:
        chunk = packed(holds, trust_cameras)
    return chunk, pairs(views(chunk), bounds, targets)
