"""Using memory again within one call, where the C library would return it after every layer."""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Iterator

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Parameters of glibc's ``mallopt``: see its manual page."""

USUAL_MMAP = 32 * 2**20
"""Where glibc's own adjustment of the threshold ends, and twice that for trimming."""


@contextlib.contextmanager
def kept_memory() -> Iterator[None]:
    """Keep freed memory for the next layer inside the context, and give it back at its end.

    By default glibc maps every array above 32 MB afresh, and the first touch of its pages costs
    more than most layers compute. Works on glibc's main thread; elsewhere nothing changes.
    """
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "mallopt") or not hasattr(libc, "malloc_trim"):
        yield
        return
    libc.mallopt(M_MMAP_THRESHOLD, 2**31 - 1)
    libc.mallopt(M_TRIM_THRESHOLD, 2**31 - 1)
    try:
        yield
    finally:
        libc.mallopt(M_MMAP_THRESHOLD, USUAL_MMAP)
        libc.mallopt(M_TRIM_THRESHOLD, 2 * USUAL_MMAP)
        libc.malloc_trim(0)
