"""The sizes of all thread pools, and what libraries must know before they start, in one place.

PyTorch and OpenCV each bring a pool as large as the machine, and kernels of our own are run by
several threads (:mod:`slgaussian.kernels.work_sharing`). Each worker of a program that runs several
calls :func:`limit`. Importing this module, which the package does first of all, also chooses where
compiled kernels are kept.

Sums of floats depend on their order, and libraries choose it by two things that have nothing to do
with the numbers. How many threads share the work: inside a network it is a fixed number
(:func:`inside`, :func:`fixed`). And where in memory an array begins, which for weights is wherever
their file has them: ``MKL_CBWR=AUTO`` makes MKL, PyTorch's linear algebra, indifferent to that.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import platform
import re
import sys
import threading
import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from torch import nn

LARGE = 20_000_000
"""Weights from which on a network gains by several threads: a layer of a smaller one takes less
time than threads take to meet."""

LARGE_THREADS = 4
"""Threads inside a large network, whatever the cores. Where they are fewer it costs nothing: CLIP
ViT-B/16 took 2.1 s of CPU for four pictures on two busy cores with one thread and with four."""


_own = threading.local()


class Sources(NamedTuple):
    """Digests of the package's sources: of those that hold kernels, and of all."""

    kernels: str
    whole: str


@cache
def sources() -> Sources:
    """What this code is, by content."""
    package = Path(__file__).parents[1]
    kernels, whole = hashlib.sha256(), hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        source = file.read_bytes()
        named = str(file.relative_to(package)).encode() + b"\0" + source
        whole.update(named)
        if re.search(rb"^(import|from) (numba|slgaussian\.kernels\.jit)\b", source, re.MULTILINE):
            kernels.update(named)
    return Sources(kernels.hexdigest(), whole.hexdigest())


def kernel_folder() -> Path:
    """Folder in the user's cache for the compiled kernels of exactly this source code.

    Numba recompiles a function when its own file changes, and not when a function that it calls
    from another file does: after an update it would go on with old code. So the folder's name is a
    digest of all the package's sources that have kernels.
    """
    caches = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(caches).expanduser() / "slgaussian" / "kernels" / sources().kernels[:16]


# NumPy's linear algebra has a pool of its own, whose threads spin while they wait: two workers side
# by side lost a fifth of their time to it, and nothing here is large enough to gain by it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# MKL reads it when it first computes. Any mode but none is indifferent to where an array begins.
# AUTO is as fast as none (82 against 80 GFLOP/s, matrices of 200 to 4096, AMD EPYC); COMPATIBLE,
# which is also the same on all kinds of processors, has 35.
os.environ.setdefault("MKL_CBWR", "AUTO")
# Virtual machines may report AMX and not run it: then bfloat16 ends with an illegal instruction.
os.environ.setdefault("ONEDNN_MAX_CPU_ISA", "AVX512_CORE_FP16")
if "NUMBA_CACHE_DIR" not in os.environ:
    # Without a home that can be written, Numba keeps its own default, beside the sources.
    with contextlib.suppress(OSError):
        kernel_folder().mkdir(parents=True, exist_ok=True)
        os.environ["NUMBA_CACHE_DIR"] = str(kernel_folder())


@cache
def processor() -> str:
    """What the processor calls itself, and how many of its cores can be used."""
    name = platform.processor() or platform.machine()
    with contextlib.suppress(OSError):  # not Linux
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                name = line.partition(":")[2].replace("(R)", "").replace("(TM)", "").strip()
                break
    return f"{name}, {cores()} cores"


def limit(workers: int = 1) -> int:
    """Size the pools that the calling thread uses for ``workers`` threads computing side by side.

    Each worker gets an equal part of the cores, at least one; that size is returned. It is kept
    for each thread, so every worker calls this itself.
    """
    import cv2
    import torch

    size = _own.size = max(1, cores() // max(1, workers))
    torch.set_num_threads(size)
    cv2.setNumThreads(size)
    return size


def allotted() -> int:
    """Threads that may share a kernel which the calling thread runs: all cores, or :func:`limit`.

    :func:`kernels_on` sets it for a while.
    """
    return getattr(_own, "size", 0) or cores()


@contextlib.contextmanager
def kernels_on(count: int) -> Iterator[None]:
    """Let ``count`` threads share the kernels that the calling thread runs, whatever the cores."""
    before = getattr(_own, "size", 0)
    _own.size = count
    try:
        yield
    finally:
        _own.size = before


@contextlib.contextmanager
def fixed(count: int = 1) -> Iterator[None]:
    """Let PyTorch compute on ``count`` threads, whatever cores there are: on it depend last bits.

    For the calling thread alone.
    """
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def inside(network: nn.Module) -> contextlib.AbstractContextManager[None]:
    """The context in which ``network`` is asked: what it says depends on no number of cores.

    One thread in a small network, :data:`LARGE_THREADS` in one of :data:`LARGE` weights or more.
    """
    weights = sum(parameter.numel() for parameter in network.parameters())
    return fixed(LARGE_THREADS if weights >= LARGE else 1)


def indifferent_to_alignment() -> bool:
    """Whether the results of PyTorch's linear algebra depend on numbers alone.

    Not so where MKL computed before :mod:`slgaussian` was imported, as it asks for its mode once.
    True where PyTorch is built on another library, of which nothing else is known.
    """
    import torch

    try:
        libraries = Path(torch.__file__).parent / "lib"
        mode = ctypes.CDLL(str(libraries / "libtorch_cpu.so")).mkl_serv_cbwr_get(-1)
    except (OSError, AttributeError):
        return True
    return mode != 1  # MKL_CBWR_BRANCH_OFF


def cores() -> int:
    """Cores that this process may use, which in a container or a batch job are not all."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def kernels() -> dict[str, str]:
    """What decides the last bits of results on this machine: its processor and libraries' code.

    ``processor`` is the kind that LLVM compiles for, ``torch`` the instructions of PyTorch's own
    kernels, ``mkl`` the mode of its linear algebra, ``openblas`` the kind of processor that NumPy's
    linear algebra takes this one for.
    """
    import llvmlite.binding
    import torch

    return {
        "machine": platform.machine(),
        "processor": llvmlite.binding.get_host_cpu_name(),
        "torch": torch.backends.cpu.get_cpu_capability(),
        "mkl": os.environ["MKL_CBWR"],
        "openblas": _openblas(),
    }


def _openblas() -> str:
    import numpy

    # Beside the package in wheels; elsewhere NumPy may use another library.
    for file in sorted(Path(numpy.__file__).parent.parent.glob("numpy.libs/*openblas*")):
        with contextlib.suppress(OSError, AttributeError):
            name = ctypes.CDLL(str(file)).scipy_openblas_get_corename64_
            name.restype = ctypes.c_char_p
            return name().decode()
    return "unknown"


# A user's program may have imported PyTorch, which does no harm, and computed with it, which does.
if "torch" in sys.modules and not indifferent_to_alignment():
    warnings.warn(
        "PyTorch has computed before slgaussian was imported, so the last bits of networks may "
        "differ from run to run; import slgaussian first, or set MKL_CBWR=AUTO",
        RuntimeWarning,
        stacklevel=2,
    )
