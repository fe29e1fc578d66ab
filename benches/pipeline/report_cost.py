"""What a large report costs: one room's result as that of many scenes and methods.

    python -m benches.pipeline.report_cost [SCENES] [METHODS]

The answers of the room are those of every scene and method, their IoUs drawn; only the cost means
anything. Prints CPU seconds, the most memory of the process, and the bytes of the page.
"""

import sys
import tempfile
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from benches.common.machine import measured
from slgaussian import build_field, datasets
from slgaussian.benchmark.evaluate import SceneResult, evaluate, truth_from_instances
from slgaussian.benchmark.resident_memory import held
from slgaussian.components.method import Method
from slgaussian.labels import LabelMaps
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.artifacts import result_to_arrays, truth_to_arrays
from tasks.context import RunContext
from tasks.report import Scored, report

SCENES, METHODS = 28, 15


def main() -> None:
    given = tuple(map(int, sys.argv[1:]))
    scenes, methods = given + (SCENES, METHODS)[len(given) :]
    with tempfile.TemporaryDirectory() as folder:
        store = ArtifactStore(folder)
        given = make(store, scenes, methods)
        before = held("VmHWM")
        start = time.process_time()
        ref = report.compute(RunContext(store), given, {}, ())
        seconds = time.process_time() - start
        sizes = {name: array.size / 1e6 for name, array in store.get(ref).items()}
    print(measured())
    print(f"{scenes} scenes, {methods} methods: {seconds:.1f} CPU s")
    print(f"memory: {held('VmHWM') / 2**30:.2f} GiB at the most, {before / 2**30:.2f} before")
    print(", ".join(f"{name} {size:.2f} MB" for name, size in sizes.items()))


def make(store: ArtifactStore, scenes: int, methods: int) -> list[Scored]:
    """What the report is of."""
    result, truth = room_result(store)
    lost = store.put("attribution", load_spec("attribution").schema.empty_table())
    made = []
    names = ["slgaussian", *(f"method {k}" for k in range(1, methods))]
    rng = np.random.default_rng(0)
    for k in range(scenes):
        own = {}
        for name in names:
            copy = renamed(result, f"scene {k}", name, rng)
            own[name] = store.put("scene_result", result_to_arrays(copy))
        made.append(Scored(f"scene {k}", own.pop("slgaussian"), truth, lost, own))
    return made


def room_result(store: ArtifactStore) -> tuple[SceneResult, ArtifactRef, Mapping[str, Any]]:
    """Of a made-up room, asked in two views; and its truth."""
    scene = datasets.load("procedural", seed=0, objects=8, views=4)
    sample = scene.sample(["view_00", "view_03"], ["view_01", "view_02"])
    field = build_field(sample, Method(keep="all"))
    truth = truth_from_instances(sample)
    labels = np.stack([view.instances for view in sample.context])
    maps = LabelMaps(labels, np.ones(labels.shape, np.float32))
    result = evaluate(field, sample, maps, truth, gaussians=field.gaussians)
    return result, store.put("truth", truth_to_arrays(truth, sample))


def renamed(result: SceneResult, scene: str, method: str, rng: np.random.Generator) -> SceneResult:
    """The same answers, of another scene and method, with other IoUs; of others no pictures."""
    rows = [{**row, "scene": scene, "method": method} for row in result.rows]
    for row in rows:
        if row["iou"] is not None:
            row["iou"] = float(np.clip(rng.normal(row["iou"], 0.1), 0, 1))
    pictures = result.pictures if method == "slgaussian" else {}
    return SceneResult(
        scene=scene,
        rows=rows,
        scene_metrics=result.scene_metrics,
        predictions=result.predictions,
        pictures=pictures,
        method=method,
    )


if __name__ == "__main__":
    main()
