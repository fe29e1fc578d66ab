"""Read the photographs and cameras of one scene into the store, once."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

from slgaussian import datasets
from slgaussian.store import ArtifactRef, ArtifactStore, sha256_of
from tasks.artifacts import sample_to_arrays
from tasks.stage import StageCall

STAGE = "ingest"
VERSION = 1


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
    return store.put("sample", sample_to_arrays(replace(sample, scene=settings["scene"])))


def file_hashes(path: str | Path, views: Sequence[str]) -> dict[str, str]:
    """SHA-256 of the camera file at ``path`` and of every file it names for the given views.

    ``path`` is a nerfstudio ``transforms.json`` or its folder; keys are relative names. What is
    missing or unreadable is left out: reading the scene says so better.
    """
    camera_file = Path(path) / "transforms.json" if Path(path).is_dir() else Path(path)
    names = [camera_file.name]
    try:
        frames = json.loads(camera_file.read_text("utf-8"))["frames"]
        for frame in frames:
            if any(_same_view(frame["file_path"], view) for view in views):
                names += [file for key, file in frame.items() if key.endswith("file_path")]
    except (OSError, ValueError, KeyError, TypeError):
        pass
    files = {name: camera_file.parent / name for name in names}
    return {name: sha256_of(file) for name, file in files.items() if file.is_file()}


def _same_view(file_path: str, view: str) -> bool:
    # Generous: a file too many in the key costs a re-read, one too few would be a stale result.
    return PurePosixPath(file_path).stem == PurePosixPath(view).stem
