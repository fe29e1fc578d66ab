"""Progress messages and time accounting of kernel compilation.

The first use of a kernel on a machine takes seconds.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

SILENT = 1.0
"""Seconds of compilation before the first message: a single small kernel needs none."""

AGAIN = 1.0
"""Smallest interval between two messages, seconds."""

_log = logging.getLogger(__name__)
_reporter: ContextVar[Callable[[str], None] | None] = ContextVar("reporter", default=None)
_lock = threading.Lock()
_watch: _Watch | None = None
_local = threading.local()


@contextmanager
def report_to(tell: Callable[[str], None]) -> Iterator[None]:
    """Report the compilation of this thread within the block to ``tell``.

    ``tell`` receives a sentence at most once a second, and an empty text when the compilation ends.
    Outside such a block the logger ``slgaussian.kernels.compiling`` warns once.
    """
    token = _reporter.set(tell)
    try:
        yield
    finally:
        _reporter.reset(token)


def watch() -> None:
    """Start to observe compilation by Numba in all threads.

    Entry points that may need kernels call it; it imports Numba.
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
    """Return the seconds that this thread has compiled kernels or waited for compilation.

    Counted since :func:`watch`.
    """
    return getattr(_local, "seconds", 0.0)


def clock() -> float:
    """Return the seconds of a clock that excludes :func:`spent`.

    Measured durations then do not include the one-time cost of compilation.
    """
    return time.perf_counter() - spent()


class _Stopped:
    """Timer of the intervals in which a thread holds or awaits Numba's compiler lock."""

    def begun(self) -> None:
        _local.depth = getattr(_local, "depth", 0) + 1
        if _local.depth == 1:
            _local.start = time.perf_counter()

    def ended(self) -> None:
        _local.depth -= 1
        if _local.depth == 0:
            _local.seconds = spent() + time.perf_counter() - _local.start


class _Watch:
    """Counter of compiled kernels. Numba's compiler lock serialises all calls.

    Kernels that a kernel calls are compiled within it.
    """

    warned = False

    def __init__(self) -> None:
        self.depth = self.kernels = 0
        self.seconds = self.start = self.last_report = 0.0
        self.showing = False

    def begun(self) -> None:
        now = time.perf_counter()
        if self.depth == 0:
            self.start = now
        self.depth += 1
        self.kernels += 1
        spent = self.seconds + now - self.start
        if spent >= SILENT and now - self.last_report >= AGAIN:
            self.last_report, self.showing = now, True
            self._report(
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
                self._report("")

    def _report(self, text: str) -> None:
        reporter = _reporter.get()
        if reporter is not None:
            reporter(text)
        elif text and not _Watch.warned:
            _Watch.warned = True
            _log.warning("compiling kernels for this processor, once; it takes up to a minute")
