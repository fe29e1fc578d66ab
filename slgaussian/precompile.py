"""Kernels compiled ahead, by a second process: the first scene on a machine waits less long.

Numba compiles one kernel at a time in a process, and a scene needs those that find depth first.
Those that it needs after that are compiled meanwhile, by having them do a little work; what is
compiled is kept on disk, where the first process finds it. One that both compile at the same time
costs what it takes and changes nothing.

    python -m slgaussian.precompile
"""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
from pathlib import Path

from slgaussian.kernels import threads


def begin() -> subprocess.Popen[bytes] | None:
    """Start that process, if no kernel has been compiled yet and there is a core for it.

    It says nothing and ends by itself. None if there was no reason to start it.
    """
    folder = os.environ.get("NUMBA_CACHE_DIR")
    if folder is None or threads.cores() < 2 or next(Path(folder).glob("*/*.nbc"), None):
        return None
    quiet = subprocess.DEVNULL
    begun = subprocess.Popen(
        [sys.executable, "-m", "slgaussian.precompile"], stdin=quiet, stdout=quiet, stderr=quiet
    )
    atexit.register(begun.poll)  # its seconds are counted with those of the first
    return begun


def work() -> None:
    """A little of everything that comes after depth: draw, tell regions and codes apart."""
    import numpy as np

    from slgaussian.gaussians import Gaussians
    from slgaussian.geometry.seen import SeenView
    from slgaussian.labels import LabelMaps
    from slgaussian.language.codes import Separated
    from slgaussian.language.nearest import nearest_code
    from slgaussian.masks.regions import Regions
    from slgaussian.rasterize.picture import picture
    from slgaussian.scene import Camera

    rng, height, width, count = np.random.default_rng(0), 48, 64, 60
    camera = Camera(np.diag([width, width, 1.0]), np.eye(4), width, height)
    cloud = {
        "means": rng.uniform(-1, 1, (count, 3)) + [0, 0, 3],
        "scales": rng.uniform(0.01, 0.1, (count, 3)),
        "quats": rng.normal(size=(count, 4)),
        "opacities": rng.random(count),
        "sh": rng.normal(size=(count, 1, 3)),
    }
    floats = {name: values.astype(np.float32) for name, values in cloud.items()}
    gaussians = Gaussians.from_arrays({**floats, "source": np.arange(count)})
    picture(gaussians, np.zeros((count, 4), np.float32), camera)
    squares = np.kron(np.arange(1, 13, dtype=np.int32).reshape(3, 4), np.ones((16, 16), np.int32))
    maps = LabelMaps(np.stack([squares] * 2), np.ones((2, *squares.shape), np.float32))
    codes = Separated()(maps, rng)
    nearest_code(codes, codes)
    image = rng.integers(0, 256, (13, 3), np.uint8)[squares]
    Regions().propose(SeenView.alone(image, np.full(squares.shape, 2, np.float32)))


if __name__ == "__main__":
    work()
