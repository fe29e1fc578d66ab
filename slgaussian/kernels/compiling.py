"""A clock that excludes kernel compilation, which takes up to a minute, once per installation."""

from __future__ import annotations

import threading
import time
from functools import cache

_local = threading.local()
_importing = threading.Lock()
"""Two threads that import Numba at once may wait for each other for ever."""


@cache
def _listen() -> None:
    """Start to measure how long each thread holds or awaits Numba's compiler lock."""
    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, event: event.Event) -> None:
            _local.depth = getattr(_local, "depth", 0) + 1
            if _local.depth == 1:
                _local.start = time.perf_counter()

        def on_end(self, event: event.Event) -> None:
            if not getattr(_local, "depth", 0):
                return  # begun before this listener
            _local.depth -= 1
            if _local.depth == 0:
                took = time.perf_counter() - _local.start
                _local.seconds = getattr(_local, "seconds", 0.0) + took

    event.register("numba:compiler_lock", Listener())


def spent() -> float:
    """Return the seconds since the first call that this thread has compiled or waited for it."""
    with _importing:
        _listen()
    return getattr(_local, "seconds", 0.0)


def clock() -> float:
    """Return the seconds of a clock that excludes :func:`spent`."""
    return time.perf_counter() - spent()
