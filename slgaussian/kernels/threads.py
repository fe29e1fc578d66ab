"""Sizes of all thread pools, and environment variables of numerical libraries, in one place.

PyTorch and OpenCV each have a pool as large as the machine, and the package's kernels run on
several threads (:mod:`slgaussian.kernels.work_sharing`). Each of several concurrent workers calls
:func:`limit`. The package imports this module first; that also sets the cache folder of compiled
kernels.

Floating-point sums depend on their order, which libraries choose by two properties unrelated to the
data. The first is the number of threads: inside a network it is fixed (:func:`inside`,
:func:`limit_threads`). The second is the memory alignment of arrays, which for weights depends on
their file: ``MKL_CBWR=AUTO`` makes MKL, PyTorch's linear algebra, independent of it.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import re
import threading
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from slgaussian import system
from slgaussian.system import cores

if TYPE_CHECKING:
    from torch import nn

LARGE_NETWORK = 20_000_000
"""Number of weights from which a network gains by several threads: a layer of a smaller one takes
less time than thread synchronisation."""

LARGE_NETWORK_THREADS = 4
"""Number of threads inside a large network, whatever the number of cores: with fewer cores it costs
no more CPU time than one thread."""


class Pool(threading.local):
    """Number of threads for kernels of the calling thread: ``size``, by default all cores."""

    size = cores()


pool = Pool()


class Sources(NamedTuple):
    """SHA-256 of the package's sources: of files with kernels, and of all files."""

    kernels: str
    package: str


@cache
def sources() -> Sources:
    """Return the digests of the sources, computed once."""
    package = Path(__file__).parents[1]
    kernels, package_digest = hashlib.sha256(), hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        source = file.read_bytes()
        named = str(file.relative_to(package)).encode() + b"\0" + source
        package_digest.update(named)
        if re.search(rb"^(import|from) (numba|slgaussian\.kernels\.jit)\b", source, re.MULTILINE):
            kernels.update(named)
    return Sources(kernels.hexdigest(), package_digest.hexdigest())


# NumPy's linear algebra has a pool whose threads spin while they wait: two concurrent workers lost
# a fifth of their time to it, and no operation here is large enough to gain by it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# MKL reads it at its first computation. Any mode is independent of alignment. AUTO is as fast as
# none (82 against 80 GFLOP/s, matrices of 200 to 4096, AMD EPYC); COMPATIBLE, which is also the
# same on all kinds of processors, has 35.
os.environ.setdefault("MKL_CBWR", "AUTO")
# Virtual machines may report AMX and not run it: then bfloat16 ends with an illegal instruction.
os.environ.setdefault("ONEDNN_MAX_CPU_ISA", "AVX512_CORE_FP16")
if "NUMBA_CACHE_DIR" not in os.environ:
    # Numba recompiles a function when its own file changes, but not when a function that it calls
    # from another file does. Therefore the folder's name is a digest of all sources with kernels.
    # Without a home that can be written, Numba keeps its own default, beside the sources.
    with contextlib.suppress(OSError):
        caches = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
        folder = caches / "slgaussian" / "kernels" / sources().kernels[:16]
        folder.mkdir(parents=True, exist_ok=True)
        os.environ["NUMBA_CACHE_DIR"] = str(folder)


@cache
def processor() -> str:
    """Return the processor's name and the number of usable cores."""
    return f"{system.processor()}, {cores()} cores"


def limit(workers: int = 1) -> int:
    """Set the pool sizes of the calling thread for ``workers`` concurrent threads.

    Each worker has an equal part of the cores, at least one; that size is returned. The setting is
    per thread, so every worker calls this itself.
    """
    import cv2
    import torch

    size = pool.size = max(1, cores() // max(1, workers))
    torch.set_num_threads(size)
    cv2.setNumThreads(size)
    return size


@contextlib.contextmanager
def limit_threads(count: int = 1) -> Iterator[None]:
    """Run PyTorch on ``count`` threads within the block, as the last bits depend on the number.

    For the calling thread only. On a GPU, convolutions are in float32, not TF32, by algorithms that
    do not depend on timings: MVSplat's distances are then 1.6e-6 from those of a CPU, not 3.6e-4,
    in the same time (H100, :mod:`benches.rasterize.on_gpu`).
    """
    import torch

    before, cudnn = torch.get_num_threads(), torch.backends.cudnn
    torch.set_num_threads(count)
    try:
        with cudnn.flags(enabled=True, deterministic=cudnn.deterministic, allow_tf32=False):
            yield
    finally:
        torch.set_num_threads(before)


def inside(network: nn.Module) -> contextlib.AbstractContextManager[None]:
    """Return the context for inference of ``network``, whose result does not depend on the cores.

    One thread for a small network, :data:`LARGE_NETWORK_THREADS` for one of :data:`LARGE_NETWORK`
    weights or more.
    """
    weights = sum(parameter.numel() for parameter in network.parameters())
    return limit_threads(LARGE_NETWORK_THREADS if weights >= LARGE_NETWORK else 1)


def kernels() -> dict[str, str]:
    """Return the properties of this machine that determine the last bits of results.

    ``processor`` is the target of LLVM, and ``torch`` the instruction set of PyTorch's kernels.
    """
    import llvmlite.binding
    import torch

    return {
        "machine": platform.machine(),
        "processor": llvmlite.binding.get_host_cpu_name(),
        "torch": torch.backends.cpu.get_cpu_capability(),
    }
