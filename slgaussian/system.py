"""Differences between Linux, macOS and Windows, in one place."""

from __future__ import annotations

import os
import platform
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

HANDS_OVER_SOCKETS = sys.platform != "win32"
"""Whether a process can pass an open socket to a process that it starts."""


def cores() -> int:
    """Return the number of cores that this process may use, in a container often not all."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def processor() -> str:
    """Return the name of the processor."""
    with suppress(OSError):  # not Linux
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].replace("(R)", "").replace("(TM)", "").strip()
    return platform.processor() or platform.machine()


def peak_memory() -> int | None:
    """Return the largest resident memory of this process so far, bytes; None on Windows.

    On Linux it includes that of the parent process when it started this one.
    """
    if resource is None:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def after_fork(forget: Callable[[], object]) -> None:
    """Call a function in each process forked from this one, on systems with fork."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=forget)


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Block SIGINT in threads and processes started within the block, if the system supports it.

    A terminal sends it to all processes of a program; only the main process should handle it.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
