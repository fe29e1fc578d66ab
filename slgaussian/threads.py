"""The sizes of all thread pools, and what Numba must know before it starts, in one place.

PyTorch, Numba and OpenCV each bring a pool as large as the machine. Importing this module, which
the package does first of all, chooses Numba's ``omp`` layer: its default where OpenMP is missing,
``workqueue``, aborts the process when two threads call it at once. It also chooses where compiled
kernels are kept. Each worker of a program that runs several calls :func:`share`.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path


def kernel_folder() -> Path:
    """Folder in the user's cache for the compiled kernels of exactly this source code.

    Numba recompiles a function when its own file changes, and not when a function that it calls
    from another file does: after an update it would go on with old code. So the folder's name is a
    digest of all the package's sources that use Numba.
    """
    package = Path(__file__).parent
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        source = file.read_bytes()
        if b"numba" in source:
            digest.update(str(file.relative_to(package)).encode() + b"\0" + source)
    caches = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(caches).expanduser() / "slgaussian" / "kernels" / digest.hexdigest()[:16]


os.environ.setdefault("NUMBA_THREADING_LAYER", "omp")
# NumPy's linear algebra has a pool of its own, whose threads spin while they wait: two workers side
# by side lost a fifth of their time to it, and nothing here is large enough to gain by it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
if "NUMBA_CACHE_DIR" not in os.environ:
    # Without a home that can be written, Numba keeps its own default, beside the sources.
    with contextlib.suppress(OSError):
        kernel_folder().mkdir(parents=True, exist_ok=True)
        os.environ["NUMBA_CACHE_DIR"] = str(kernel_folder())


def share(workers: int = 1) -> int:
    """Size the pools that the calling thread uses for ``workers`` threads computing side by side.

    Each worker gets an equal part of the cores, at least one; that size is returned. Numba and
    OpenMP keep the size for each thread, so every worker calls this itself.
    """
    import cv2
    import numba
    import torch

    size = max(1, cores() // max(1, workers))
    numba.set_num_threads(min(size, numba.config.NUMBA_NUM_THREADS))
    torch.set_num_threads(size)
    cv2.setNumThreads(size)
    return size


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Let PyTorch compute on one thread: sums of gradients depend on how many share them."""
    import numba
    import torch

    numba.get_num_threads()  # starts Numba's pool, which would set PyTorch's size anew later
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def cores() -> int:
    """Cores that this process may use, which in a container or a batch job are not all."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def numba_layer() -> str:
    """The threading layer that Numba really starts with, found by starting it.

    Raises
    ------
    ValueError
        By Numba, if the layer asked for is not available.
    """
    import numba

    @numba.njit(parallel=True)
    def count(n: int) -> int:
        total = 0
        for i in numba.prange(n):
            total += i
        return total

    count(4)
    return numba.threading_layer()
