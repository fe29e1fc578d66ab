"""Depth table of the plane sweep; ``benches/predict/novel_view_error.py`` has the novel views.

``python -m benches.predict.depth_error [DATA]``: the motorcycle pair, and every scene of DATA, a
nerfstudio folder with ``pairs.json`` (scene -> context, target) and sensor depth. Printed per
direction: mean and median relative depth error and the share within a factor of 1.25, over the
pixels with true depth that fall inside the other view; per scene: the median error of sharp feature
matches triangulated with the refined pose, which is what the poses and the sensor allow, and the
least seconds on the clock and CPU seconds of three runs. Last, CPU seconds by stage and the peak of
memory.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import slgaussian.kernels.threads
from benches.common.photograph_pairs import photographs
from slgaussian import datasets
from slgaussian.benchmark.resident_memory import held
from slgaussian.cameras.match_graph import MatchGraph
from slgaussian.cameras.matches import sift_matches
from slgaussian.gaussians import source_depths
from slgaussian.predict import planesweep, view_graph
from slgaussian.predict.planesweep import PlaneSweep
from slgaussian.predict.view_graph import INLIER, link_views
from slgaussian.scene import Sample, View

STAGES = {
    "link_views": planesweep,
    "settle": view_graph,
    "matching_cost": planesweep,
    "combine": planesweep,
    "aggregate": planesweep,
    "winners": planesweep,
    "cross_check": planesweep,
    "without_speckles": planesweep,
    "color_gains": planesweep,
    "lend": planesweep,
    "fit_planes": planesweep,
    "fill": planesweep,
    "weighted_median": planesweep,
    "blend": planesweep,
    "kept_near": planesweep,
    "unproject": planesweep,
    "needed": planesweep,
    "hidden": planesweep,
}
"""Functions in the order of the road, by the module that calls them."""

SIZE = (416, 576)
RUNS = 3
spent = dict.fromkeys([*STAGES, "elsewhere"], 0.0)
within: list[float] = []
"""Seconds of the stages that have ended within each that is running."""


def timed(name: str, call: Callable[..., Any]) -> Callable[..., Any]:
    """The call, which adds its seconds to those spent, but for those of stages that it calls."""

    def wrapper(*args: Any, **settings: Any) -> Any:
        start = time.process_time()
        within.append(0.0)
        out = call(*args, **settings)
        seconds = time.process_time() - start
        spent[name] += seconds - within.pop()
        if within:
            within[-1] += seconds
        return out

    return wrapper


def depth_errors(view: View, other: View, depth: np.ndarray) -> tuple[float, float, float]:
    pixels, z = other.camera.project(view.camera.unproject(view.depth))
    inside = (pixels >= 0).all(-1) & (pixels < (other.camera.width, other.camera.height)).all(-1)
    judged = (view.depth > 0) & (z > 0) & inside
    found, true = depth[judged], view.depth[judged]
    off = np.abs(found - true) / true
    close = np.maximum(found / true, true / found) < 1.25
    return float(off.mean()), float(np.median(off)), float(close.mean())


def sparse_error(sample: Sample) -> float:
    """Median relative depth error of SIFT matches near their refined epipolar lines."""
    views = sample.context
    relative = link_views(views, MatchGraph.of(views), ranged=False).links[0][0].relative
    greys = [cv2.cvtColor(view.image, cv2.COLOR_RGB2GRAY) for view in views]
    a, b = sift_matches(*greys)
    fits = np.abs(relative.epipolar_distance(a, b)) < INLIER
    found = relative.triangulate(a[fits], b[fits])
    column, row = a[fits].astype(int).T
    true = views[0].depth[row, column]
    known = (true > 0) & (found > 0)
    return float(np.median(np.abs(1 / found[known] - true[known]) / true[known]))


def run(sample: Sample) -> tuple[np.ndarray, float, float]:
    """Depths, and seconds on the clock and of the processor."""
    walls, seconds = [], []
    for _ in range(RUNS):
        wall, start = time.perf_counter(), time.process_time()
        gaussians = timed("elsewhere", PlaneSweep())(sample)
        seconds.append(time.process_time() - start)
        walls.append(time.perf_counter() - wall)
    depths = source_depths(gaussians, [v.camera for v in sample.context])
    return depths, min(walls), min(seconds)


def motorcycle() -> None:
    sample = datasets.load("stereo").sample(context=["left", "right"], size="original")
    left, right = (view.camera for view in sample.context)
    scale = left.K[0, 0] * np.linalg.norm(right.center - left.center)
    depths, wall, seconds = run(sample)
    true = sample.context[0].depth
    known = true > 0
    bad = np.abs(scale / depths[0][known] - scale / true[known]) > 2
    print(f"motorcycle  bad-2.0 {100 * bad.mean():.2f} %  {wall:.2f} s  {seconds:.2f} CPU s")


def pairs(folder: Path) -> None:
    scene = datasets.load("nerfstudio", folder)
    print("scene            abs-rel median d<1.25 | abs-rel median d<1.25 | sparse |    s CPU s")
    rows, times, floors = [], [], []
    for name, pair in json.loads((folder / "pairs.json").read_text()).items():
        sample = scene.sample(pair["context"], pair["target"], size=SIZE)
        depths, wall, seconds = run(sample)
        a, b = sample.context
        both = [depth_errors(a, b, depths[0]), depth_errors(b, a, depths[1])]
        rows += both
        times.append((wall, seconds))
        floors.append(sparse_error(sample))
        cells = " | ".join("{:7.3f} {:6.3f} {:6.3f}".format(*row) for row in both)
        print(f"{name:16s} {cells} |  {floors[-1]:.3f} | {wall:4.2f} {seconds:5.2f}")
    print("mean             {:7.4f} {:6.4f} {:6.4f}".format(*np.mean(rows, 0)), end="")
    wall, seconds = np.mean(times, 0)
    print(f"  sparse {np.mean(floors):.4f}  {wall:.2f} s  {seconds:.2f} CPU s")
    print("worst direction  {:7.4f} {:6.4f}".format(*np.max(rows, 0)[:2]), end="")
    print(f" {np.min(rows, 0)[2]:6.4f}")
    stages(len(times))


def stages(count: int) -> None:
    """CPU seconds of each stage for one of so many pairs, without those of stages within it."""
    shares = "  ".join(f"{name} {seconds / count / RUNS:.3f}" for name, seconds in spent.items())
    print(f"CPU s a pair:  {shares}")


if __name__ == "__main__":
    data = photographs(sys.argv[1]) if len(sys.argv) > 1 else None
    slgaussian.kernels.threads.limit()
    PlaneSweep()(datasets.load("stereo").sample(["left", "right"]))  # Compiles.
    for stage, module in STAGES.items():
        setattr(module, stage, timed(stage, getattr(module, stage)))
    motorcycle()
    if data:
        spent.update(dict.fromkeys(spent, 0.0))
        pairs(data)
    else:
        stages(1)
    print(f"peak memory {held('VmHWM') / 2**30:.2f} GiB")
