"""Memory that this process holds, from the kernel's own counts, which Linux has."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from slgaussian.system import memory_status, reset_peak_memory, trim_memory


def give_back() -> None:
    """Let go of what is not used any more, so that it counts for nobody."""
    gc.collect()
    trim_memory()


_watching: list[Peak] = []
"""Those whose blocks are open: another block within would have the system forget their peak."""


class Peak:
    """The most that this process holds within some blocks, and what it held before.

    Blocks may be nested, and each knows its own most.

    Attributes
    ----------
    before, most : int or None
        Bytes; None where the system does not say, and of ``most`` as long as no block ended.
    """

    def __init__(self) -> None:
        give_back()
        self.before = _held("VmRSS")
        self.most: int | None = None

    @contextmanager
    def watched(self) -> Iterator[None]:
        """A block of which the most counts."""
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
        """Bytes of the most beyond what was held before; None where one is not known."""
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
