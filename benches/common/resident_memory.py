"""Resident memory of this process, from the counters of the Linux kernel."""

import ctypes
import gc
from pathlib import Path


def give_back() -> None:
    """Free unused memory, so that it is not attributed to the next measurement."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)


def memory_status(name: str) -> int:
    """Return bytes from /proc/self/status, such as ``VmRSS`` (resident) or ``VmHWM`` (its peak)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith(f"{name}:"))


def reset_peak_memory() -> None:
    """Reset ``VmHWM`` to the current resident memory."""
    Path("/proc/self/clear_refs").write_text("5")
