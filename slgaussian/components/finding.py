"""What a check found, in a sentence."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """What a check found; ``good`` is None for what is neither good nor bad."""

    name: str
    said: str
    good: bool | None = True


Findings = Iterator[Finding]
