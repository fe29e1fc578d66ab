"""What only a fresh process can tell: memory of one rendering, and time from nothing to a picture.

:func:`memory_rows` and :func:`start_rows` start this file again as a program. Imports are inside
the functions because importing is what the program times.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

BORN = time.monotonic()
REPEATS = 3
START = {
    "python": "Python itself",
    "torch": "import torch",
    "slgaussian": "import slgaussian.rasterize, with Numba",
    "first": "first picture",
    "second": "second picture",
}

if TYPE_CHECKING:
    import torch

    from slgaussian.gaussians import Gaussians
    from slgaussian.scene import Camera


def memory_rows(gaussians: "Gaussians", values: "torch.Tensor", camera: "Camera") -> list[dict]:
    """Rows ``what``, ``peak`` and ``kept`` (MB), each job done once in a process of its own.

    Before it, the process has done the same for a tiny scene: inputs, libraries and kernels are in
    memory already and not counted; results are.
    """
    with tempfile.TemporaryDirectory() as folder:
        scene = save_scene(Path(folder), gaussians, values, camera)
        return [{"what": job} | run_fresh("memory", scene, job) for job in jobs()]


def start_rows(gaussians: "Gaussians", values: "torch.Tensor", camera: "Camera") -> list[dict]:
    """Rows ``what``, ``cached`` and ``compiling`` (seconds): with kernels on disk, and without.

    The first is the median over processes; reading the scene is not counted.
    """
    with tempfile.TemporaryDirectory() as folder:
        scene = save_scene(Path(folder), gaussians, values, camera)
        compiling = run_fresh("start", scene, NUMBA_CACHE_DIR=folder)
        run_fresh("start", scene)
        cached = [run_fresh("start", scene) for _ in range(REPEATS)]
    rows = [
        {"what": what, "cached": median(run[key] for run in cached), "compiling": compiling[key]}
        for key, what in START.items()
    ]
    total = {key: sum(row[key] for row in rows[:-1]) for key in ("cached", "compiling")}
    return [*rows, {"what": "process start to first picture"} | total]


def save_scene(
    folder: Path, gaussians: "Gaussians", values: "torch.Tensor", camera: "Camera"
) -> Path:
    import numpy as np

    path = folder / "scene.npz"
    seen = {"K": camera.K, "c2w": camera.c2w, "size": [camera.width, camera.height]}
    np.savez(path, **gaussians.to_arrays(), **seen, values=values.numpy())
    return path


def run_fresh(*arguments: object, **environment: str) -> dict:
    """The JSON that this file prints when run with these arguments."""
    done = subprocess.run(
        [sys.executable, "-m", __spec__.name, str(time.monotonic()), *map(str, arguments)],
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        check=True,
    )
    return json.loads(done.stdout)


# What the fresh process does.


def load_scene(path: str) -> tuple["Gaussians", "torch.Tensor", "Camera"]:
    import numpy as np
    import torch

    from slgaussian.gaussians import Gaussians
    from slgaussian.scene import Camera

    arrays = dict(np.load(path))
    camera = Camera(arrays.pop("K"), arrays.pop("c2w"), *arrays.pop("size"))
    values = torch.from_numpy(arrays.pop("values"))
    return Gaussians.from_arrays(arrays), values, camera


def start(begun: float, scene: str) -> dict[str, float]:
    """Seconds of every key of ``START``."""
    marks = [begun, BORN]
    import torch  # noqa: F401

    marks.append(time.monotonic())
    from slgaussian.rasterize import rasterize

    marks.append(time.monotonic())
    loaded = load_scene(scene)
    waited = time.monotonic() - marks[-1]
    for _ in range(2):
        rasterize(*loaded)
        marks.append(time.monotonic() - waited)
    return {key: marks[i + 1] - marks[i] for i, key in enumerate(START)}


def jobs() -> dict:
    """What memory is measured of, by name: each takes Gaussians, values and camera."""
    from dataclasses import replace

    import torch

    from slgaussian.rasterize import plan, rasterize

    def both_ways(gaussians: "Gaussians", values: "torch.Tensor", camera: "Camera") -> list:
        names = ("means", "scales", "quats", "opacities")
        leaves = {name: getattr(gaussians, name).requires_grad_() for name in names}
        wanted = [*leaves.values(), values.requires_grad_()]
        drawn = rasterize(replace(gaussians, **leaves), values, camera).values
        return [drawn, torch.autograd.grad(drawn.sum(), wanted)]

    return {
        "one picture": rasterize,
        "forward and backward": both_ways,
        "plan of one view": lambda gaussians, _, camera: plan(gaussians, camera),
    }


def memory(_: float, scene: str, job: str) -> dict[str, float]:
    """``peak`` and ``kept``: MB of resident memory more than before, at most and at the end."""
    import gc

    from slgaussian.benchmark.resident_memory import forget_peak, held
    from slgaussian.gaussians import Gaussians

    gaussians, values, camera = load_scene(scene)
    few = {name: array[:100].copy() for name, array in gaussians.to_arrays().items()}
    jobs()[job](Gaussians.from_arrays(few), values[:100].clone(), camera.resized(32, 32))
    gc.collect()
    before = held("VmRSS")
    forget_peak()
    result = jobs()[job](gaussians, values, camera)
    peak, kept = (held("VmHWM") - before) / 1e6, (held("VmRSS") - before) / 1e6
    del result
    return {"peak": peak, "kept": kept}


if __name__ == "__main__":
    task, begun = {"start": start, "memory": memory}[sys.argv[2]], float(sys.argv[1])
    print(json.dumps(task(begun, *sys.argv[3:])))
