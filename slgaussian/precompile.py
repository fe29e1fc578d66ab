"""Compilation of kernels in a second process, so that the first scene on a machine is faster.

Numba compiles one kernel at a time in a process. While the main process compiles the kernels of
depth prediction, which a scene needs first, this process compiles the kernels of later steps by
running them on small inputs. Compiled code is cached on disk, where the main process loads it. If
both processes compile the same kernel, the only cost is the time.

    python -m slgaussian.precompile
"""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
from pathlib import Path

from slgaussian.kernels import threads


def announce() -> bool:
    """Return whether no kernel is cached yet; then print a sentence to standard error."""
    folder = os.environ.get("NUMBA_CACHE_DIR")
    if folder is None or next(Path(folder).glob("*/*.nbc"), None):
        return False
    print("compiling kernels for this processor, once, up to a minute", file=sys.stderr)
    return True


def begin() -> subprocess.Popen[bytes] | None:
    """Start the second process if :func:`announce` and there is a second core, else return None.

    It prints nothing and ends by itself.
    """
    if not announce() or threads.cores() < 2:
        return None
    quiet = subprocess.DEVNULL
    begun = subprocess.Popen(
        [sys.executable, "-m", "slgaussian.precompile"], stdin=quiet, stdout=quiet, stderr=quiet
    )
    atexit.register(begun.poll)  # so that its CPU time counts for this process
    return begun


def work() -> None:
    """Run all steps after depth prediction on small inputs: rendering, regions, codes."""
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
