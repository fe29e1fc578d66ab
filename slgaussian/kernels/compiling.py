"""Kernels that are being compiled: the first use of one takes seconds, once a machine.

People are told so, and clocks can leave it out.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

SILENT = 1.0
"""Seconds of compiling before a word is said: a single small kernel is not worth one."""

AGAIN = 1.0
"""Seconds at least between two words."""

_log = logging.getLogger(__name__)
_tell: ContextVar[Callable[[str], None] | None] = ContextVar("tell", default=None)
_lock = threading.Lock()
_watch: _Watch | None = None
_own = threading.local()


@contextmanager
def told_to(tell: Callable[[str], None]) -> Iterator[None]:
    """Have ``tell`` told what this thread compiles within the block.

    It is given a sentence at most once a second, and an empty text once the work goes on. Without
    it a program is told once, by a warning of the logger ``slgaussian.kernels.compiling``.
    """
    token = _tell.set(tell)
    try:
        yield
    finally:
        _tell.reset(token)


def watch() -> None:
    """Tell from now on, in all threads, when Numba compiles what it does not have in its cache.

    Called where the work begins that may need kernels; it imports Numba.
    """
    global _watch
    from numba.core import event

    class Listener(event.Listener):
        def __init__(self, watch: _Watch | _Stopped) -> None:
            self.watch = watch

        def on_start(self, event: event.Event) -> None:
            self.watch.begun()

        def on_end(self, event: event.Event) -> None:
            self.watch.ended()

    with _lock:
        if _watch is None:
            _watch = _Watch()
            event.register("numba:compile", Listener(_watch))
            event.register("numba:compiler_lock", Listener(_Stopped()))


def spent() -> float:
    """Seconds that this thread has compiled kernels or waited for others that did.

    Since :func:`watch` was called.
    """
    return getattr(_own, "seconds", 0.0)


def clock() -> float:
    """Seconds of a clock that stands still during :func:`spent`.

    What takes time once an installation is no part of what work takes.
    """
    return time.perf_counter() - spent()


class _Stopped:
    """The time in which a thread has, or waits for, the lock under which Numba compiles."""

    def begun(self) -> None:
        _own.depth = getattr(_own, "depth", 0) + 1
        if _own.depth == 1:
            _own.start = time.perf_counter()

    def ended(self) -> None:
        _own.depth -= 1
        if _own.depth == 0:
            _own.seconds = spent() + time.perf_counter() - _own.start


class _Watch:
    """What was compiled so far. Numba lets one thread compile at a time, and so speak to this.

    Kernels that a kernel calls are compiled within it.
    """

    said_once = False

    def __init__(self) -> None:
        self.depth = self.kernels = 0
        self.seconds = self.start = self.told = 0.0
        self.showing = False

    def begun(self) -> None:
        now = time.perf_counter()
        if self.depth == 0:
            self.start = now
        self.depth += 1
        self.kernels += 1
        spent = self.seconds + now - self.start
        if spent >= SILENT and now - self.told >= AGAIN:
            self.told, self.showing = now, True
            self._say(
                "compiling kernels for this processor, once, up to a minute: "
                f"{self.kernels} in {spent:.0f} s"
            )

    def ended(self) -> None:
        self.depth -= 1
        if self.depth == 0:
            took = time.perf_counter() - self.start
            self.seconds += took
            if self.showing:
                self.showing = False
                self._say("")

    def _say(self, text: str) -> None:
        tell = _tell.get()
        if tell is not None:
            tell(text)
        elif text and not _Watch.said_once:
            _Watch.said_once = True
            _log.warning("compiling kernels for this processor, once; it takes up to a minute")
