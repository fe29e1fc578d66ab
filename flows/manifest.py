"""What a report was made of: settings, data, weights, versions, kernels. Nothing of when or where.

The same run with another number of workers, another place of the data or another machine of the
same kind has the same manifest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from flows.settings import TABLES, Method, SceneSettings, Settings
from slgaussian import __version__, datasets
from slgaussian.benchmark.annotations import categories_of, frame_names
from slgaussian.benchmark.baselines import Row
from slgaussian.benchmark.protocols import PROTOCOLS
from slgaussian.datasets.photographs import stored_size
from slgaussian.datasets.published import Found, standing
from slgaussian.errors import InputError
from slgaussian.io import file_sha256
from slgaussian.kernels import threads
from slgaussian.storage.provenance import software
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef
from tasks.stage import Stage


def manifest(
    settings: Settings,
    scenes: Sequence[SceneSettings],
    stages: Sequence[Stage],
    refs: Mapping[str, Mapping[str, ArtifactRef]],
    others: Mapping[str, Row],
) -> dict[str, Any]:
    """The manifest of a run, as plain data.

    ``refs`` are what the ``stages`` made by scene, of those scenes that went through, and
    ``others`` the methods beside ours.
    """
    shown = settings.model_dump(mode="json", include=Method.model_fields.keys() | {"method"})
    own = {name: shown[name] for name in shown if name not in TABLES} | settings.identity
    weights = {
        f"{part.name}.{key}": known.digest
        for part in settings.built_by.components
        for key, known in part.files.items()
    }
    return {
        "spec": load_spec("manifest").label,
        "slgaussian": __version__,
        "seed": settings.seed,
        "settings": own,
        "methods": {name: _described(row) for name, row in others.items()},
        "protocols": [protocol.label for protocol in PROTOCOLS.values()],
        "weights": weights,
        "index": {}
        if settings.pairs is None
        else {"file": settings.pairs.name, "sha256": file_sha256(settings.pairs)},
        "stages": {stage.name: stage.version for stage in stages},
        "packages": software(),
        "kernels": threads.kernels(),
        "data": {
            scene.name: _data(scene, refs[scene.name]) for scene in scenes if scene.name in refs
        },
    }


def _described(row: Row) -> str:
    own = ", ".join(f"{name} {value}" for name, value in {**row.settings, **row.rules}.items())
    name = f"{row.method} of {row.brought_by}" if row.brought_by else row.method
    return f"{name} ({own})" if own else name


def _data(scene: SceneSettings, refs: Mapping[str, ArtifactRef]) -> dict[str, Any]:
    """What a scene is, and what was read of it: files, and the digests of what they amount to."""
    # Sorted: what comes from a record of the store has lost its order.
    files, labels = (
        dict(sorted(refs[stage].meta["settings"][of]["files"].items()))
        for stage, of in (("ingest", "photographs"), ("truth", "labels"))
    )
    return {
        "dataset": scene.dataset,
        "format": scene.format,
        "scene": scene.options.get("scene", ""),
        "options": {name: str(value) for name, value in scene.options.items()},
        "context": scene.context,
        "targets": scene.targets,
        "published": published_as(scene),
        "cameras": refs["ingest"].meta["cameras"],
        "left_out": refs["ingest"].meta["left_out"],
        "sample": refs["ingest"].digest,
        "truth": refs["truth"].digest,
        "files": files,
        "labels": labels,
    }


def published_as(scene: SceneSettings) -> dict[str, str]:
    """Which published scene its labels and photographs are of: fields of ``Standing``, or none."""
    if scene.labels is None or scene.path is None:
        return {}
    asked, sizes = {}, {}
    try:
        for target in scene.targets:
            frame = Path(target).stem
            asked[frame] = categories_of(scene.labels, target)
            files, _ = datasets.inputs(scene.format, scene.path, [target], **scene.options)
            for file in files:
                if file.stem == frame and (size := stored_size(file)):
                    sizes[frame] = size
        frames = frame_names(scene.labels)
    except (InputError, OSError):  # results that are there outlive their data
        return {}
    name = str(scene.options.get("scene") or scene.labels.name)
    known = standing(Found(scene.format, name, asked, frames, sizes))
    return {} if known is None else asdict(known)
