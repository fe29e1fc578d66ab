"""Lineage: from a number in the results of a run back to artifacts, stages, settings and files.

Everything is in the folder of the run, so neither its store nor its data are needed.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from slgaussian.benchmark.reports.comparison import read_run
from slgaussian.errors import InputError, did_you_mean
from slgaussian.extras import install_line
from slgaussian.io import atomic_path, file_sha256
from slgaussian.storage.encoding import decode_table
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef

if TYPE_CHECKING:
    from openlineage.client.event_v2 import RunEvent

Row = dict[str, Any]

ANSWERS = ("benchmark", "baselines")
"""Stages with the answers of a method."""

SCORES = ("iou", "boundary_iou", "class_iou", "hit_mask", "score")
"""Numbers of an answer that are printed."""


def lineage_table(
    refs: Mapping[tuple[str, str], Mapping[str, ArtifactRef]], versions: Mapping[str, int]
) -> pa.Table:
    """Return a table of spec ``lineage``.

    Args:
        refs: {(scene, method): {stage: ref}}. Results of stages in the order of their computation.
        versions: Version of each stage.
    """
    rows = [
        {
            "scene": scene,
            "method": method,
            "stage": stage,
            "version": versions[stage],
            "spec": ref.spec,
            "digest": ref.digest,
            "inputs": json.dumps(ref.meta["inputs"], sort_keys=True),
            "settings": json.dumps(ref.meta["settings"], sort_keys=True),
        }
        for (scene, method), by_stage in refs.items()
        for stage, ref in by_stage.items()
    ]
    return pa.Table.from_pylist(rows, schema=load_spec("lineage").schema)


def trace(place: str | Path, answer: str | None = None) -> dict[str, Any]:
    """Return what the answers of a run come from, as plain data.

    Args:
        place: Folder of the run, or a file in it such as the report.
        answer: ``"SCENE/QUERY"``, or ``"SCENE"`` for all its queries; default all answers.

    Returns:
        dict: Version and commit of ``slgaussian``; ``run``, the digest of its manifest; and rows:
            ``numbers`` (of spec ``samples``), ``artifacts`` (of spec ``lineage``, last first) and
            ``files`` (``scene``, ``kind``, ``name``, ``digest``).

    Raises:
        InputError: If there are no such results, scene or query.
        SpecError: If a table is damaged.
    """
    folder = Path(place) if Path(place).is_dir() else Path(place).parent
    run, file = read_run(folder), folder / "lineage.parquet"
    if not (file.is_file() and run.manifest):
        raise InputError(
            f"{folder}: {file.name} or manifest.json is missing, expected the results of a run; "
            "older versions did not write them: run it again"
        )
    table = decode_table(file.read_bytes(), load_spec("lineage"), str(file), "run it again")
    asked = {row["scene"]: row["scene"] for row in run.rows}
    asked |= {f"{row['scene']}/{row['query']}": row["scene"] for row in run.rows}
    if answer is not None and answer not in asked:
        raise InputError(
            f"{folder}: found no answer {answer!r}{did_you_mean(answer, asked)}; expected "
            f"SCENE/QUERY, such as {next(reversed(asked), 'none')!r}, or SCENE"
        )
    scenes = set(asked.values()) if answer is None else {asked[answer]}
    needed, artifacts = set[str](), dict[tuple[str, ...], Row]()
    for row in reversed(table.to_pylist()):  # results before their inputs
        if row["scene"] in scenes and (row["stage"] in ANSWERS or row["digest"] in needed):
            row |= {key: json.loads(row[key]) for key in ("inputs", "settings")}
            needed |= set(row["inputs"].values())
            # A variant that shares an artifact with the field comes first, and gives way to it.
            key = row["scene"], row["stage"], row["digest"]
            artifacts.pop(key, None)
            artifacts[key] = row
    files = [file for row in reversed(artifacts.values()) for file in _files(row)]
    text = json.dumps([row["settings"] for row in artifacts.values()])
    for name, digest in run.manifest["weights"].items():
        if digest in text:
            files.append({"scene": "", "kind": "weights", "name": name, "digest": digest})
    return {
        "slgaussian": run.manifest["slgaussian"],
        "commit": run.manifest.get("commit", "unknown"),
        "run": file_sha256(folder / "manifest.json"),
        "numbers": [
            row for row in run.rows
            if answer in (None, row["scene"], f"{row['scene']}/{row['query']}")
        ],
        "artifacts": list(artifacts.values()),
        "files": list({tuple(file.values()): file for file in files}.values()),
    }  # fmt: skip


def _files(artifact: Row) -> Iterator[Row]:
    """Yield a row for each photograph or label file that the stage read."""
    for kind in ("photographs", "labels"):
        settings = artifact["settings"].get(kind) or {}
        for name, digest in settings.get("files", {}).items():
            yield {"scene": artifact["scene"], "kind": kind, "name": name, "digest": digest}


def format_trace(traced: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of a text: numbers, artifacts and files of :func:`trace`."""
    for row in traced["numbers"]:
        scores = (f"{name} {row[name]:.4g}" for name in SCORES if row[name] is not None)
        yield f"{row['scene']}/{row['query']} in {row['frame']}, by {row['method']}"
        yield f"  {row['protocol']}: {', '.join(scores) or row['note']}"
    yield f"slgaussian {traced['slgaussian']}, commit {traced['commit']}"
    for row in traced["artifacts"]:
        yield f"{row['stage']} v{row['version']}: {row['spec']} {row['digest'][:12]}"
        yield f"  of {row['scene']}, for {row['method']}"
        for name, digest in row["inputs"].items():
            yield f"  from {name} {digest[:12]}"
        for name, value in row["settings"].items():
            yield f"  {name}: {json.dumps(value, ensure_ascii=False)}"
    for file in traced["files"]:
        yield f"{file['digest']}  {file['kind']}  {file['name']}"


NAMESPACE = "slgaussian"
"""Namespace of jobs and datasets in OpenLineage."""


def events(traced: Mapping[str, Any], time: datetime) -> list[RunEvent]:
    """Return OpenLineage events, START and COMPLETE of each artifact of :func:`trace`.

    Jobs are stages. Datasets are files, SCENE/FILE, and artifacts, SCENE/METHOD/STAGE, with their
    digests as versions. The same run gives the same run ids. ``time`` is that of all events, as
    results have no times.

    Raises:
        InputError: If ``openlineage-python`` is not installed.
    """
    try:
        from openlineage.client import event_v2, facet_v2
    except ImportError as error:
        raise InputError(f"OpenLineage: {error}; {install_line('lineage')}") from error

    execution, parent_run = facet_v2.execution_parameters_run, facet_v2.parent_run
    program = {key: traced[key] for key in ("slgaussian", "commit")}
    names = {
        (row["scene"], row["digest"]): f"{row['scene']}/{row['method']}/{row['stage']}"
        for row in traced["artifacts"]
    }

    def run_id(name: str) -> str:
        return str(uuid.uuid5(uuid.NAMESPACE_OID, f"{traced['run']} {name}"))

    def dataset(kind: Any, name: str, digest: str) -> Any:
        version = facet_v2.dataset_version_dataset.DatasetVersionDatasetFacet(digest)
        return kind(NAMESPACE, name, facets={"version": version})

    parent = parent_run.ParentRunFacet(parent_run.Run(run_id("")), parent_run.Job(NAMESPACE, "run"))
    results = []
    for row in reversed(traced["artifacts"]):
        read = {f"{row['scene']}/{file['name']}": file["digest"] for file in _files(row)}
        read |= {names[row["scene"], digest]: digest for digest in row["inputs"].values()}
        settings = {**program, "stage_version": row["version"], **row["settings"]}
        parameters = [
            execution.ExecutionParameter(key, value=json.dumps(v)) for key, v in settings.items()
        ]
        facets = {
            "parent": parent,
            "executionParameters": execution.ExecutionParametersRunFacet(parameters),
        }
        name = names[row["scene"], row["digest"]]
        results += [
            event_v2.RunEvent(
                eventTime=time.isoformat(),
                eventType=state,
                run=event_v2.Run(run_id(name), facets),
                job=event_v2.Job(NAMESPACE, row["stage"]),
                inputs=[dataset(event_v2.InputDataset, *each) for each in read.items()],
                outputs=[dataset(event_v2.OutputDataset, name, row["digest"])],
            )
            for state in (event_v2.RunState.START, event_v2.RunState.COMPLETE)
        ]
    return results


def send(traced: Mapping[str, Any], place: str | Path, target: str) -> int:
    """Write the :func:`events` of results to a file, a line each, or send them to an HTTP address.

    Their time is that of the file or folder ``place``. Credentials of a server are in the client's
    configuration: its file, or variables ``OPENLINEAGE__``. Returns the number of events.

    Raises:
        InputError: As :func:`events`, or if they cannot be written or sent.
    """
    completed = events(traced, datetime.fromtimestamp(Path(place).stat().st_mtime, UTC))
    from openlineage.client import OpenLineageClient

    is_url = target.startswith(("http://", "https://"))
    try:
        with nullcontext(target) if is_url else atomic_path(target) as sink:
            to_file = {"type": "file", "log_file_path": sink, "append": True}
            transport = {"type": "http", "url": sink} if is_url else to_file
            # The client would add the repository of the working folder, which is not this program.
            facets = {"source_code_location": {"disabled": True}}
            client = OpenLineageClient(config={"transport": transport, "facets": facets})
            for event in completed:
                client.emit(event)
            client.close()
    except Exception as error:  # of any transport
        raise InputError(f"{target}: cannot write or send the events ({error})") from error
    return len(completed)
