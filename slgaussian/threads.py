"""The sizes of all thread pools, and Numba's threading layer, in one place.

PyTorch, Numba and OpenCV each bring a pool as large as the machine. Importing this module, which
must happen before Numba starts its first parallel loop, chooses Numba's ``omp`` layer: its default
where OpenMP is missing, ``workqueue``, aborts the process when two threads call it at once.
Each worker of a program that runs several calls :func:`share`.
"""

from __future__ import annotations

import os

os.environ.setdefault("NUMBA_THREADING_LAYER", "omp")


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
