"""Nights of many scenes, simulated: runs that find the results of all scenes in the store.

    python -m benches.pipeline.nights WORK [-o docs/measured] [--scenes 100 1000 10000]

The store is filled with the artifacts of one small room, with fewer Gaussians and a few numbers
changed for each scene. Then the flow of ``slgaussian run`` runs twice, unchanged, with a Prefect
server that keeps task runs: the first time it computes the report. Files are counted by their
names; *links* are those of them that are hard links to files of the store. The database is measured
when the server has received the last task run.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import sqlite3
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from benches.common.harness import parser, publish, table
from flows.runners.environment import prepare
from flows.runners.server import DATABASE, LocalServer
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians
from slgaussian.storage.encoding import Arrays
from slgaussian.storage.store import ArtifactRef, ArtifactStore

COLUMNS = {
    "scenes": ("scenes", ",d"),
    "night": ("night", str),
    "seconds": ("s", ",.0f"),
    "processor": ("CPU s", ",.0f"),
    "task_runs": ("task runs", ",d"),
    "database": ("database grows, MB", ",.1f"),
    "out": ("files of results", ",d"),
    "links": ("of them links", ",d"),
    "memory": ("peak memory, MB", ",.0f"),
}


def vary(arrays: Mapping[str, np.ndarray], scene: str) -> Arrays:
    """Return arrays that differ for every scene: its name, and a number or the first pixels."""
    number, varied = int(scene.rpartition("_")[2]), dict(arrays)
    if "quats" in arrays:
        varied |= {name: array[:99] for name, array in arrays.items() if name != "origin"}
    if "rows" in arrays:
        rows = [row | {"scene": scene} for row in json.loads(str(arrays["rows"]))]
        varied |= {"scene": np.array(scene), "rows": np.array(json.dumps(rows))}
    for name, array in varied.items():
        if array.dtype in (np.float32, np.float64, bool) and array.any():
            varied[name] = array.copy()
            if array.dtype == bool:
                varied[name].flat[:14] = [number >> bit & 1 for bit in range(14)]
            else:
                varied[name].flat[np.abs(array).argmax()] *= 1 - 1e-6 * number
            break
    return varied


def stand_in(store: ArtifactStore, ref: ArtifactRef) -> Callable[..., ArtifactRef]:
    """Return the function of a stage that copies its artifact of another store, varied."""
    from tasks.artifacts import get_field, put_field

    content = store.get(ref)

    def copy(run: Any, *arguments: object, **named: object) -> ArtifactRef:
        if ref.spec == "field":
            field = get_field(store, ref)
            gaussians = Gaussians.from_arrays(vary(field.gaussians.to_arrays(), run.scene))
            varied = SemanticField(gaussians, field.bank, field.cameras, field.settings)
            put = put_field(run.store, varied)
            return replace(put, meta={**ref.meta, **put.meta})
        for uri in ref.meta.get("parts", ()):
            run.store.write(uri, store.read(uri))
        varied = vary(content, run.scene) if isinstance(content, dict) else content
        return run.store.put(ref.spec, varied, ref.meta)

    return copy


def fill(room: ArtifactStore, config: Any) -> None:
    """Fill the store of a run with the results of its scenes, without waiting for the disk."""
    from prefect.utilities.annotations import quote

    from flows.benchmark import find_scenes
    from flows.runners.batches import compute_scene
    from flows.scene import STAGES, scene_task

    def without_prefect(compute: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *args: compute(*(a.unwrap() if isinstance(a, quote) else a for a in args))

    tasks = [scene_task(config, scene) for scene in find_scenes(config)[0]]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: None)
        for stage in STAGES:
            patch.setattr(stage, "task", without_prefect(stage.task.fn))
        refs = compute_scene(tasks[0], room, 1, lambda event: None).refs
        for stage in STAGES:
            patch.setattr(stage, "compute", stand_in(room, refs[stage.name]))
        for task in tasks:
            run = compute_scene(task, ArtifactStore(config.store), 1, lambda event: None)
            assert run.failure is None, run.failure


def read_counts(server: LocalServer) -> tuple[int, float]:
    """Return the numbers of task runs and of megabytes of the server, when they rest."""
    counts = [-1, -2]
    while counts[-1] != counts[-2]:
        time.sleep(3)
        counts.append(httpx.post(f"{server.url}/task_runs/count", json={}, timeout=300).json())
    with closing(sqlite3.connect(server.home / DATABASE, timeout=60)) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        names = ("page_count", "page_size")
        pages, size = (database.execute(f"PRAGMA {name}").fetchone()[0] for name in names)
    return counts[-1], pages * size / 1e6


def nights(server: LocalServer, work: Path, scenes: int) -> Iterator[dict[str, Any]]:
    """Run two nights of the same scenes into one folder; yield a row for each."""
    from flows.benchmark import score_scenes
    from flows.read_config import make_settings

    shutil.rmtree(work, ignore_errors=True)
    places = {"out": work / "out", "store": str(work / "store")}
    config = make_settings({"rooms": f"0-{scenes - 1}", "size": "64x96", **places}, "nights")
    fill(ArtifactStore(work / "room"), config)
    for night in ("new report", "cached"):
        before, start, processor = read_counts(server), time.perf_counter(), time.process_time()
        score_scenes(config)
        row = {"scenes": scenes, "night": night, "seconds": time.perf_counter() - start}
        row["processor"] = time.process_time() - processor
        after = read_counts(server)
        row |= {"task_runs": after[0] - before[0], "database": after[1] - before[1]}
        links = [file.stat().st_nlink > 1 for file in config.out.rglob("*") if file.is_file()]
        row |= {"out": len(links), "links": sum(links)}
        row["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        print(row, flush=True)
        yield row


def main() -> None:
    arguments = parser(__doc__, "scale.md")
    arguments.add_argument("work", type=Path, help="folder for the stores and the server")
    arguments.add_argument("--scenes", type=int, nargs="*", default=[100, 1000, 10000])
    args = arguments.parse_args()
    work = args.work.resolve()
    server = LocalServer(work / "server")
    os.environ["PREFECT_API_URL"] = server.url  # first, so that logs are sent to it too
    prepare(work / "server")
    server.start()
    try:
        server.wait()
        rows = [row for scenes in args.scenes for row in nights(server, work / "nights", scenes)]
    finally:
        server.stop()
    publish(args.out, "scale.md", "python -m benches.pipeline.nights WORK", table(rows, COLUMNS))


if __name__ == "__main__":
    main()
