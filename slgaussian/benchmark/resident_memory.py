"""Memory that this process holds, from the kernel's own counts, which Linux has."""

from __future__ import annotations

import ctypes
import gc
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


def held(name: str) -> int:
    """Bytes that /proc/self/status says of ``VmRSS`` (now), ``VmHWM`` (the most) or another.

    Not ``getrusage``, whose peak a process has from the one that started it. OSError elsewhere.
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
    with suppress(OSError, TypeError, AttributeError):  # another library of C has none
        ctypes.CDLL(None).malloc_trim(0)


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
        for one in tuple(_watching):
            one._note()
        with suppress(OSError):
            forget_peak()
        _watching.append(self)
        try:
            yield
        finally:
            _watching.remove(self)
            for one in (self, *_watching):
                one._note()

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
        return held(name)
    except OSError:
        return None
