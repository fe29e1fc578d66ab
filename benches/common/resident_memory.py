"""How much memory this process holds, from the kernel's own counts; needs Linux."""

import ctypes
import gc
from pathlib import Path


def held(name: str) -> int:
    """Bytes that /proc/self/status says of ``VmRSS`` (now), ``VmHWM`` (the most) or another.

    Not ``getrusage``, whose peak a process has from the one that started it.
    """
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return 1024 * int(line.split()[1])
    raise OSError(f"/proc/self/status: has no {name}")


def forget_peak() -> None:
    """Let ``VmHWM`` begin with what is held now."""
    Path("/proc/self/clear_refs").write_text("5")


def give_back() -> None:
    """Let go of what is not used any more, so that it counts for nobody."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
