"""Resident memory of this process, from the counters of the Linux kernel."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from slgaussian.system import memory_status, reset_peak_memory, trim_memory


def give_back() -> None:
    """Free unused memory, so that it is not attributed to the next measurement."""
    gc.collect()
    trim_memory()


_watching: list[Peak] = []
"""Peaks with open blocks, which are updated before a nested block resets the system's counter."""


class Peak:
    """Peak memory of this process within blocks, and its memory before.

    Blocks may be nested; each has its own peak.

    Attributes
    ----------
    before, most : int or None
        Bytes; None if the system has no counter, and for ``most`` before the end of a block.
    """

    def __init__(self) -> None:
        give_back()
        self.before = _held("VmRSS")
        self.most: int | None = None

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Measure the peak within the block."""
        for peak in tuple(_watching):
            peak._note()
        with suppress(OSError):
            reset_peak_memory()
        _watching.append(self)
        try:
            yield
        finally:
            _watching.remove(self)
            for peak in (self, *_watching):
                peak._note()

    @property
    def grown(self) -> int | None:
        """Return the increase from ``before`` to the peak in bytes; None if unknown."""
        if self.before is None or self.most is None:
            return None
        return max(0, self.most - self.before)

    def _note(self) -> None:
        reached = _held("VmHWM")
        if reached is not None:
            self.most = max(reached, self.most or 0)


def _held(name: str) -> int | None:
    try:
        return memory_status(name)
    except OSError:
        return None
