"""Read the photographs and cameras of one scene into the store, once."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian import datasets
from slgaussian.errors import InputError
from slgaussian.scene import Sample
from slgaussian.storage.store import ArtifactRef, ArtifactStore, sha256_of
from tasks.artifacts import sample_to_arrays
from tasks.stage import StageCall

STAGE = "ingest"
VERSION = 3


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``sample``. Settings: scene, format, options, context, targets, size, near, far, files.

    ``where["path"]`` is the data folder of a format that reads files; ``files`` holds what
    :func:`file_hashes` says of them.
    """
    settings = call.settings
    paths = [call.where["path"]] if "path" in call.where else []
    scene = datasets.load(settings["format"], *paths, **settings["options"])
    size = settings["size"]
    sample = scene.sample(
        settings["context"],
        settings["targets"],
        size if isinstance(size, str) else tuple(size),
        settings["near"],
        settings["far"],
    )
    sample = replace(sample, scene=settings["scene"])
    _check_held_out(sample)
    return store.put("sample", sample_to_arrays(sample))


def _check_held_out(sample: Sample) -> None:
    for target in sample.targets:
        for view in sample.context:
            same = "is" if target.name == view.name else "is the same picture as"
            blank = (target.image == target.image[0, 0]).all()
            if target.name == view.name or (not blank and np.array_equal(target.image, view.image)):
                raise InputError(
                    f"scene {sample.scene!r}: the target {target.name!r} {same} the context view "
                    f"{view.name!r}; a target must be held out"
                )


def file_hashes(
    format: str, path: str | Path, views: Sequence[str], options: Mapping[str, Any]
) -> dict[str, str]:
    """SHA-256 of every file that the given views are read from, by its path below ``path``.

    What is missing or unreadable is left out: reading the scene says so better.
    """
    folder = Path(path) if Path(path).is_dir() else Path(path).parent
    try:
        files = datasets.files(format, path, views, **options)
    except InputError:
        return {}
    return {
        os.path.relpath(file, folder): _digest(file, file.stat().st_mtime_ns, file.stat().st_size)
        for file in files
        if file.is_file()
    }


@lru_cache(maxsize=1024)
def _digest(file: Path, changed: int, size: int) -> str:
    """SHA-256 of a file that many scenes may share, as a chunk or a model."""
    return sha256_of(file)
