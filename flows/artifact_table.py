"""Which artifact is what a stage made of a scene: one table in the output folder of a run.

The store knows by keys what was made; whoever has the results and not the settings has this table.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from flows.runners.batches import Outcome
from slgaussian.io import write_atomic
from slgaussian.storage.encoding import encode_table
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactStore

FILE = "artifacts.parquet"
SPEC = "artifacts"


def write_artifacts(out: Path, store: ArtifactStore, outcomes: Sequence[Outcome]) -> None:
    """Write the table of all that jobs made, those that failed among them, to folder ``out``.

    OSError if it cannot be written.
    """
    spec = load_spec(SPEC)
    rows = [row for outcome in outcomes for row in _rows(outcome, store)]
    table = pa.Table.from_pylist(rows, schema=spec.schema)
    spec.check_table(table, str(out / FILE))
    write_atomic(out / FILE, encode_table(table, spec))


def _rows(outcome: Outcome, store: ArtifactStore) -> Iterator[dict[str, Any]]:
    for scene, stages in sorted((outcome.partial | outcome.refs).items()):
        for stage, ref in stages.items():
            of_stage = {
                "scene": scene,
                "stage": stage,
                "stage_version": ref.meta["stage_version"],
                "cached": ref.meta.get("cached", False),
            }
            yield of_stage | {
                "inputs": sorted(_digests(ref.meta)),
                "spec": ref.spec,
                "uri": ref.uri,
                "digest": ref.digest,
                "bytes": ref.meta.get("bytes", _size(store, ref.uri)),
                "seconds": ref.meta["seconds"],
                "processor": ref.meta.get("processor"),
            }
            for uri in ref.meta.get("parts", ()):
                yield of_stage | {
                    "spec": uri.split("/")[0],
                    "uri": uri,
                    "digest": Path(uri).stem,
                    "part_of": ref.digest,
                    "inputs": [],
                    "bytes": _size(store, uri),
                }


def _digests(meta: Mapping[str, Any]) -> set[str]:
    """Of all artifacts that a stage was given, wherever they stand among its arguments."""
    found = set(meta.get("inputs", {}).values())
    waiting = [meta.get("settings", {})]
    while waiting:
        value = waiting.pop()
        if isinstance(value, Mapping):
            if value.keys() == {"spec", "digest"}:
                found.add(value["digest"])
            waiting += value.values()
        elif isinstance(value, list):
            waiting += value
    return found


def _size(store: ArtifactStore, uri: str) -> int | None:
    stamp = store.stamp(uri)
    return None if stamp is None else int(stamp.split()[0])
