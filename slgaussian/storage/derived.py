"""What is derived of a few photographs, kept so that a larger scene need not derive it again.

Results are known by what they were computed from, so that a kept one is the same, to the bit, as a
new one: it saves time and changes nothing. What depends on the whole scene, as depth in the end and
objects do, is not kept. Who builds a field says with :func:`keeping` where results are kept;
otherwise nothing is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

Arrays = Mapping[str, np.ndarray]


class Derived:
    """Results by what they are, the version of their code, and what they were computed from.

    Parameters
    ----------
    before : mapping str -> arrays by name
        ``kept`` of another time.

    Attributes
    ----------
    kept : dict str -> arrays by name
        All that were asked for, those that were there before among them.
    reused, made : Counter
        How many were there before, and how many were not, by what they are.
    """

    def __init__(self, before: Mapping[str, Arrays] | None = None) -> None:
        self.before = before or {}
        self.kept: dict[str, Arrays] = {}
        self.reused: Counter[str] = Counter()
        self.made: Counter[str] = Counter()

    def once(self, what: str, version: int, content: str, make: Callable[[], Arrays]) -> Arrays:
        """As :func:`once`."""
        key = f"{what}/v{version}/{content}"
        if key not in self.kept:
            old = self.before.get(key)
            (self.made if old is None else self.reused)[what] += 1
            self.kept[key] = make() if old is None else old
        return self.kept[key]

    def summary(self) -> str:
        """What was reused, for people, as "4 of 5 outlines"."""
        found = sorted((self.reused + self.made).items())
        return ", ".join(f"{self.reused[what]} of {count} {what}" for what, count in found)


_kept: ContextVar[Derived | None] = ContextVar("derived", default=None)


@contextmanager
def keeping(derived: Derived) -> Iterator[None]:
    """Keep within the block what :func:`once` is asked for, and take what was there before."""
    token = _kept.set(derived)
    try:
        yield
    finally:
        _kept.reset(token)


def once(what: str, version: int, content: Callable[[], str], make: Callable[[], Arrays]) -> Arrays:
    """What ``make`` makes, or made before of the same; it is shared, so none may change it.

    Parameters
    ----------
    what : str
        What it is, for people, in the plural; without "/".
    version : int
        Raised by hand whenever the same content would give another result.
    content : callable
        Returns a digest of all that the result depends on; called only if results are kept.
    make : callable
        Returns arrays by name, none of which holds objects.
    """
    derived = _kept.get()
    return make() if derived is None else derived.once(what, version, content(), make)
