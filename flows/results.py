"""Outputs of a run besides scores: its fields, its manifest, and the file that repeats it."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from flows.config import TABLES, Method, SceneSettings, Settings
from flows.scene import scene_task
from flows.sweep import combinations, sweep_tasks
from slgaussian import __version__
from slgaussian.benchmark.annotations import labelled_frames
from slgaussian.benchmark.baselines import Row
from slgaussian.benchmark.outputs import file_name, write_table
from slgaussian.benchmark.protocols import PROTOCOLS
from slgaussian.datasets.labelled_sets import is_published
from slgaussian.datasets.sources import hash_files
from slgaussian.errors import InputError, SpecError
from slgaussian.kernels import threads
from slgaussian.storage import field_folder, run_file
from slgaussian.storage.encoding import decode_table
from slgaussian.storage.provenance import commit, software
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import CONCURRENT_READS, ArtifactRef, ArtifactStore
from tasks.artifacts import about_field
from tasks.stage import Stage

FIELDS = "fields"
"""Folder of the fields, and their table."""

OMITTED = {"store", "runner", "workers", "refresh", "only_missing", "out",
           "data", "format", "pairs", "labels", "rooms"}  # fmt: skip
"""Settings without effect on results, and those of scenes, which ``run.toml`` lists."""


def field_place(scene: str, out: Path) -> Path:
    """Return the folder of a scene's field."""
    return out / FIELDS / file_name(scene)


def check_places(scenes: Iterable[str], out: Path) -> None:
    """Raise InputError if the folder of a field has other content; call it before the work."""
    for scene in scenes:
        field_folder.check_free(field_place(scene, out))


def write_fields(
    store: ArtifactStore,
    fields: Mapping[str, ArtifactRef],
    places: Mapping[str, str],
    out: Path,
) -> None:
    """Write the fields by scene below folder ``out``, and a table of them.

    Their files are hard links to those in the store if possible, as they are by far the largest
    output of a run. Unchanged fields are not written again; fields of an earlier run that this run
    does not have are removed. ``places`` are the locations of the encoder's files.

    Raises:
        DamagedError: If an artifact is missing or damaged.
        InputError: If other content is at the path of a field, or the store does not answer.
        OSError: If a folder cannot be written.
    """
    for folder in _earlier(out) - {file_name(scene) for scene in fields}:
        if (out / FIELDS / folder / field_folder.FIELD_FILE).is_file():
            shutil.rmtree(out / FIELDS / folder)
    rows = [
        {"scene": scene, "folder": file_name(scene)}
        | {name: ref.meta[name] for name in ("gaussians", "objects")}
        for scene, ref in fields.items()
    ]
    write_table(FIELDS, pa.Table.from_pylist(rows, schema=load_spec(FIELDS).schema), out)

    def write(scene: str) -> None:
        description, parts = about_field(store, fields[scene])
        folder, text = field_place(scene, out), description.to_json(places)
        files = {spec: folder / field_folder.FILES[spec] for spec in parts}
        file = folder / field_folder.FIELD_FILE  # with the digests of the files
        described = file.is_file() and file.read_bytes() == text.encode()
        # Where files are hard links, damage of the store is damage of the folder.
        if not described or not all(store.has_content(parts[k], f) for k, f in files.items()):
            field_folder.write(folder, text, lambda spec, at: store.link_or_copy(parts[spec], at))

    store.map(write, list(fields), CONCURRENT_READS)


def _earlier(out: Path) -> set[str]:
    """Return the folders in the table of an earlier run; none if it cannot be read."""
    file = out / f"{FIELDS}.parquet"
    try:
        table = decode_table(file.read_bytes(), load_spec(FIELDS), str(file))
    except (OSError, SpecError):
        return set()
    return {name for name in table["folder"].to_pylist() if file_name(name) == name}


def manifest(
    settings: Settings,
    scenes: Sequence[SceneSettings],
    stages: Sequence[Stage],
    refs: Mapping[str, Mapping[str, ArtifactRef]],
    baselines: Mapping[str, Row],
) -> dict[str, Any]:
    """Return the manifest of a run as plain data.

    ``scenes`` are completed, ``refs`` are the results of ``stages`` by scene, and ``baselines`` the
    other methods.
    """
    names = (Method.model_fields.keys() | {"method"}) - TABLES.keys()
    return {
        "spec": load_spec("manifest").label,
        "slgaussian": __version__,
        "commit": commit(),
        "seed": settings.seed,
        "settings": settings.model_dump(mode="json", include=names)
        | settings.field_method.identity(),
        "methods": {name: _describe_method(row) for name, row in baselines.items()},
        "protocols": [protocol.label for protocol in PROTOCOLS.values()],
        "weights": _weights(settings),
        "stages": {stage.name: stage.version for stage in stages},
        "packages": software(),
        "kernels": threads.kernels(),
        "data": {scene.name: _data(scene, refs[scene.name]) for scene in scenes},
    }


def _describe_method(row: Row) -> str:
    text = ", ".join(f"{name} {value}" for name, value in {**row.settings, **row.rules}.items())
    name = f"{row.method} of {row.package_identity}" if row.package_identity else row.method
    return f"{name} ({text})" if text else name


def _data(scene: SceneSettings, refs: Mapping[str, ArtifactRef]) -> dict[str, Any]:
    """Describe the data of a scene: views, files, and digests of files and artifacts."""
    name = scene.options.get("scene", "")
    try:
        frames = labelled_frames(scene.labels) if scene.labels else ()
    except InputError:  # a label file that this run does not use is damaged
        frames = ()
    # Sorted, as records in the store do not preserve the order.
    files, labels = (
        dict(sorted(refs[stage].meta["settings"][of]["files"].items()))
        for stage, of in (("ingest", "photographs"), ("truth", "labels"))
    )
    return {
        "dataset": scene.dataset,
        "format": scene.format,
        "scene": name,
        "options": {name: str(value) for name, value in scene.options.items()},
        "context": scene.context,
        "targets": scene.targets,
        "published": is_published(scene.format, name, frames),
        "cameras": refs["ingest"].meta["cameras"],
        "left_out": refs["ingest"].meta["left_out"],
        "sample": refs["ingest"].digest,
        "truth": refs["truth"].digest,
        "files": files,
        "labels": labels,
    }


def run_toml(
    settings: Settings,
    scenes: Sequence[SceneSettings],
    refs: Mapping[tuple[str, str], Mapping[str, ArtifactRef]],
) -> bytes:
    """Return a configuration that repeats a run, with all its inputs.

    ``refs`` are the results of stages by scene and method, those of our method first.
    """
    variants = (variant.settings for variant in combinations(settings))
    used = {c.table for each in (settings, *variants) for c in each.components} & TABLES.keys()
    omitted = OMITTED | (TABLES.keys() - used)
    values = settings.model_dump(mode="json", exclude_none=True, exclude=omitted)
    values["scenes"] = [scene.model_dump(mode="json", exclude_none=True) for scene in scenes]
    places = {table: TABLES[table].files() for table in used}
    inputs = run_file.Inputs.from_refs(refs, _weights(settings))
    return run_file.encode(values, places, inputs, settings.out)


def check_inputs(
    settings: Settings, scenes: Sequence[SceneSettings], recorded: run_file.Inputs, source: str
) -> list[str]:
    """Compare all inputs with those of file ``source``; describe the result in lines.

    InputError if a file differs, with its name, or cannot be read.
    """
    variants, _ = sweep_tasks(combinations(settings), scenes)
    every = [*(scene_task(settings, scene) for scene in scenes), *variants]
    tasks = {task.scene: task.arguments for task in every}
    present = {scene.name: run_file.SceneInputs() for scene in scenes}
    for name in (name for name in recorded.scenes if name in tasks):
        photographs, labels, *_ = tasks[name]
        folder = labels.folder or Path()
        files = hash_files((folder / file for file in recorded.scenes[name].labels), folder)
        present[name] = run_file.SceneInputs.from_settings(photographs.inputs, files)
    now = run_file.Inputs(software=run_file.software(), weights=_weights(settings), scenes=present)
    return recorded.check(now, source)


def _weights(settings: Settings) -> dict[str, str]:
    """Return the digests of the files of components, those of variants if they differ."""
    weights = dict[str, str]()
    for variant in (None, *combinations(settings)):
        for part in (variant.settings if variant else settings).field_method.components:
            for key, file in part.known_files.items():
                name, digest = f"{part.name}.{key}", file.digest or ""
                if variant and weights.get(name, digest) != digest:
                    name = f"{variant.name}: {name}"
                weights[name] = digest
    return weights
