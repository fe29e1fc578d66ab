"""Differences between Linux, macOS and Windows, in one place."""

from __future__ import annotations

import ctypes
import getpass
import os
import platform
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

HANDS_OVER_SOCKETS = sys.platform != "win32"
"""True where a process can start another with an open socket of its own."""


def cores() -> int:
    """Return the cores that this process may use, which in a container or a job are not all."""
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


def user() -> str:
    """Return the name of the user, or the number where there is no name, as in a container."""
    try:
        return getpass.getuser()
    except (ImportError, KeyError, OSError):
        return str(os.getuid()) if hasattr(os, "getuid") else "unknown"


def memory_status(name: str) -> int:
    """Return bytes by /proc/self/status: ``VmRSS`` (resident), ``VmHWM`` (its peak) or another.

    Not ``getrusage``, whose peak a process has from the one that started it. OSError where there is
    no such file, as on all systems but Linux.
    """
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return 1024 * int(line.split()[1])
    raise OSError(f"/proc/self/status: has no {name}")


def forget_peak() -> None:
    """Reset ``VmHWM`` to the resident memory of now; OSError where there is none."""
    Path("/proc/self/clear_refs").write_text("5")


def trim_memory() -> None:
    """Give what is freed back to the system, where its C library can."""
    with suppress(OSError, TypeError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def after_fork(forget: Callable[[], object]) -> None:
    """Call a function in each process that is forked from this one, where there are forks."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=forget)


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Block SIGINT in threads and processes that start within the block, where that can be.

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
