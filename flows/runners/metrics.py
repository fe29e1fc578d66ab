"""A run in numbers, while it is on: as cells of a table, and as a sentence."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class Metrics:
    """What is known of a run so far.

    Attributes
    ----------
    unit : str
        What is counted: scenes, or chunks.
    done, failed, scenes : int
        How many went through, were left out, and are asked for.
    steps, stages : int
        Stages that are done, and those that there are to do.
    computed, cached : int
        How many of them were worked on, and how many were found in the store.
    rate : float
        Scenes done a minute, cached ones too.
    left : float or None
        Seconds that the rest will take, if that can be known.
    memory, peak : int
        Bytes of this process and all that it started, now and at most.
    """

    unit: str
    done: int
    failed: int
    scenes: int
    steps: int
    stages: int
    computed: int
    cached: int
    rate: float
    left: float | None
    memory: int
    peak: int

    def cells(self) -> Iterator[tuple[str, str]]:
        """Heading and value of each column."""
        if self.scenes > 1:
            yield self.unit, f"{self.done} of {self.scenes}"
            yield "failed", str(self.failed)
            yield "a minute", f"{self.rate:.3g}" if self.done else "-"
            yield "left", "-" if self.left is None else duration(self.left)
        else:
            yield "stages", f"{self.steps} of {self.stages}"
        yield "computed", str(self.computed)
        yield "cached", str(self.cached)
        yield "memory", size(self.memory)
        yield "peak", size(self.peak)

    def sentence(self) -> str:
        """The same in one line."""
        many = self.scenes > 1
        told = [f"{self.done}/{self.scenes} {self.unit}"] if many else []
        told += [f"{self.failed} failed"] if self.failed else []
        told += [f"{self.steps}/{self.stages} stages", f"{self.computed} computed"]
        told += [f"{self.cached} cached"] if self.cached else []
        told += [f"{self.rate:.3g} {self.unit} a minute"] if many and self.done else []
        told += [] if self.left is None else [f"about {duration(self.left)} left"]
        told.append(f"{size(self.memory)} of memory, at most {size(self.peak)}")
        return ", ".join(told)


def duration(seconds: float) -> str:
    """A time as people say it."""
    minutes = round(seconds / 60)
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    if minutes < 100:
        return f"{minutes} min"
    if minutes < 48 * 60:
        return f"{minutes // 60} h {minutes % 60} min"
    return f"{minutes // 1440} d {minutes % 1440 // 60} h"


def size(count: int) -> str:
    """A number of bytes as people say it."""
    return f"{count / 2**30:.1f} GiB" if count >= 2**30 else f"{count / 2**20:.0f} MiB"
