"""How much memory this program takes, with all the processes that it started."""

from __future__ import annotations

from contextlib import suppress

import psutil


def memory_in_use() -> int:
    """Bytes in memory of this process and all below it.

    Only what is a process's own, where the system tells it apart: the code of libraries, which
    processes share, is not counted.
    """
    own, total = psutil.Process(), 0
    for process in (own, *own.children(recursive=True)):
        with suppress(psutil.Error):  # it has ended since
            held = process.memory_info()
            total += held.rss - getattr(held, "shared", 0)
    return total
