"""How much memory this program takes, with all the processes that it started, from the kernel."""

from __future__ import annotations

import os
from collections import defaultdict
from contextlib import suppress
from pathlib import Path

PROC = Path("/proc")


def memory_in_use() -> int | None:
    """Bytes in memory of this process and all below it; None where the kernel does not tell.

    Only what is a process's own: the code of libraries, which they share, is not counted.
    """
    if not (PROC / "self" / "statm").exists():
        return None
    children = defaultdict(list)
    for process in map(int, filter(str.isdigit, os.listdir(PROC))):
        with suppress(OSError):  # it has ended since
            children[_parent(process)].append(process)
    own, total = [os.getpid()], 0
    while own:
        process = own.pop()
        own += children[process]
        with suppress(OSError):
            _, resident, shared, *_ = map(int, (PROC / f"{process}/statm").read_bytes().split())
            total += (resident - shared) * os.sysconf("SC_PAGE_SIZE")
    return total


def _parent(process: int) -> int:
    # The second word is the program's name in brackets, which may hold anything.
    return int((PROC / f"{process}/stat").read_bytes().rpartition(b")")[2].split()[1])
