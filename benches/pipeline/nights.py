"""Nights of many scenes, simulated: runs that find the results of all scenes in the store.

    python -m benches.pipeline.nights WORK [-o docs/measured] [--scenes 100 1000 10000]

The store is filled with copies of the artifacts of one small room, with fewer Gaussians and a few
numbers changed so that every file is another. Then the flow of ``slgaussian run`` runs twice,
unchanged, with a Prefect server that keeps task runs: the first time it computes the report. Files
are counted by their names; *links* are those of them that are hard links to files of the store. The
database is measured when the server has received the last task run.
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
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from benches.common.harness import parser, publish, table
from flows.runners.environment import prepare
from flows.runners.server import DATABASE, LocalServer
from slgaussian.storage.field_folder import About
from slgaussian.storage.store import ArtifactRef, ArtifactStore

SIZE = "64x96"

COLUMNS = {
    "scenes": ("scenes", ",d"),
    "night": ("night", str),
    "seconds": ("s", ",.0f"),
    "processor": ("CPU s", ",.0f"),
    "task_runs": ("task runs", ",d"),
    "database": ("database grows, MB", ",.1f"),
    "out": ("files of results", ",d"),
    "links": ("of them links", ",d"),
    "store": ("new files of the store", ",d"),
    "memory": ("peak memory, MB", ",.0f"),
}


def vary(arrays: Mapping[str, np.ndarray], scene: str) -> dict[str, np.ndarray]:
    """Return arrays that differ for every scene: its name, and a number or the first pixels."""
    number = int(scene.rpartition("_")[2])
    if "quats" in arrays:
        arrays = {name: array if name == "origin" else array[:99] for name, array in arrays.items()}
    varied = dict(arrays)
    if "scene" in arrays:
        varied["scene"] = np.array(scene)
    if "rows" in arrays:
        rows = json.loads(str(arrays["rows"]))
        varied["rows"] = np.array(json.dumps([row | {"scene": scene} for row in rows]))
    for name, array in arrays.items():
        if array.dtype in (np.float32, np.float64) and array.any():
            varied[name] = array.copy()
            varied[name].flat[np.abs(array).argmax()] *= 1 - 1e-6 * number
            break
    else:
        if "masks" in arrays:
            varied["masks"] = arrays["masks"].copy()
            varied["masks"].flat[:14] = [number >> bit & 1 for bit in range(14)]
    return varied


def stand_in(store: ArtifactStore, ref: ArtifactRef) -> Callable[..., ArtifactRef]:
    """Return the function of a stage that copies its artifact of another store, varied."""
    from tasks.artifacts import get_field

    content = store.get(ref)
    field = get_field(store, ref) if ref.spec == "field" else None
    matches = None
    if "matches" in ref.meta:
        matches = store.get(ArtifactRef("matches", **ref.meta["matches"]))

    def copy(run: Any, *arguments: object, **named: object) -> ArtifactRef:
        meta = dict(ref.meta)
        if matches is not None:
            put = run.store.put("matches", vary(matches, run.scene))
            meta |= {"matches": {"uri": put.uri, "digest": put.digest}, "parts": [put.uri]}
        if field is not None:
            parts = {
                spec: run.store.put(spec, vary(of, run.scene) if isinstance(of, dict) else of)
                for spec, of in field.contents().items()
            }
            digests = {spec: part.digest for spec, part in parts.items()}
            about = About(field.settings, field.cameras, digests).to_json()
            meta["parts"] = [part.uri for part in parts.values()]
            return run.store.put("field", {"about": np.array(about)}, meta)
        if isinstance(content, dict):
            return run.store.put(ref.spec, vary(content, run.scene), meta)
        names = [run.scene] * len(content)
        place = content.schema.get_field_index("scene")
        return run.store.put(ref.spec, content.set_column(place, content.field(place), [names]))

    return copy


def files_below(folder: Path) -> dict[str, int]:
    """Return the number of links of each file below a folder, by path."""
    places = (Path(at, name) for at, _, names in os.walk(folder) for name in names)
    return {str(place): place.stat().st_nlink for place in places if ".prefect" not in place.parts}


def recorded(server: LocalServer) -> tuple[int, float]:
    """Return the numbers of task runs and of megabytes of the server, when they rest."""
    counts = [-1, -2]
    while counts[-1] != counts[-2]:
        time.sleep(3)
        counts.append(httpx.post(f"{server.url}/task_runs/count", json={}, timeout=300).json())
    with closing(sqlite3.connect(server.home / DATABASE, timeout=60)) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        (pages,), (size,) = (
            database.execute(f"PRAGMA {name}").fetchone() for name in ("page_count", "page_size")
        )
    return counts[-1], pages * size / 1e6


def without_prefect(compute: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function of a task, with the arguments that a stage passes to its task."""
    from prefect.utilities.annotations import quote

    def call(*arguments: Any) -> Any:
        return compute(*(a.unwrap() if isinstance(a, quote) else a for a in arguments))

    return call


def fill(work: Path, config: Any) -> None:
    """Fill the store of a run with the results of its scenes, without waiting for the disk."""
    from flows.benchmark import scenes_of
    from flows.runners.batches import compute_scene
    from flows.scene import STAGES, scene_task

    scenes, store, room = scenes_of(config)[0], ArtifactStore(config.store), ArtifactStore(work)
    tasks = [scene_task(config, scene) for scene in scenes]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: None)
        for stage in STAGES:
            patch.setattr(stage, "task", without_prefect(stage.task.fn))
        refs, _ = compute_scene(tasks[0], room, 1, lambda event: None)
        for stage in STAGES:
            patch.setattr(stage, "compute", stand_in(room, refs[stage.name]))
        for task in tasks:
            _, failure = compute_scene(task, store, 1, lambda event: None)
            assert failure is None, failure


def nights(server: LocalServer, work: Path, scenes: int) -> Iterator[dict[str, Any]]:
    """Run two nights of the same scenes into one folder; yield a row for each."""
    from flows.benchmark import score_scenes
    from flows.read_config import make_settings

    shutil.rmtree(work, ignore_errors=True)
    store, out = work / "store", work / "out"
    values = {"rooms": f"0-{scenes - 1}", "size": SIZE, "out": out, "store": str(store)}
    config = make_settings(values, "nights")
    fill(work / "room", config)
    for night in ("new report", "cached"):
        before, (tasks, size) = files_below(store), recorded(server)
        start, processor = time.perf_counter(), time.process_time()
        score_scenes(config)
        row: dict[str, Any] = {"scenes": scenes, "night": night}
        row["seconds"] = time.perf_counter() - start
        row["processor"] = time.process_time() - processor
        after, (tasks_after, size_after) = files_below(store), recorded(server)
        written = files_below(out)
        row |= {"task_runs": tasks_after - tasks, "database": size_after - size}
        row |= {"out": len(written), "links": sum(count > 1 for count in written.values())}
        row |= {"store": len(after.keys() - before.keys())}
        row["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        print(row, flush=True)
        yield row


def main() -> None:
    arguments = parser(__doc__, "scale.md")
    arguments.add_argument("work", type=Path, help="folder for the stores and the server")
    arguments.add_argument("--scenes", type=int, nargs="*", default=[100, 1000, 10000])
    args = arguments.parse_args()
    work = args.work.resolve()
    prepare(work / "server")
    server = LocalServer(work / "server")
    os.environ["PREFECT_API_URL"] = server.url
    server.start()
    try:
        server.wait()
        rows = [row for scenes in args.scenes for row in nights(server, work / "nights", scenes)]
    finally:
        server.stop()
    publish(args.out, "scale.md", "python -m benches.pipeline.nights WORK", table(rows, COLUMNS))


if __name__ == "__main__":
    main()
