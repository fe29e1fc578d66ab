"""What happens to scenes while they are worked on, as workers tell it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Event:
    """Something that happened to a scene at a stage."""

    scene: str
    stage: str


@dataclass(frozen=True)
class Started(Event):
    """The stage began."""


@dataclass(frozen=True)
class Said(Event):
    """The stage, which is being worked on, has come as far as ``text`` says."""

    text: str


@dataclass(frozen=True)
class Finished(Event):
    """The stage is done, after ``seconds``; or was found done, ``cached``."""

    seconds: float
    cached: bool


@dataclass(frozen=True)
class Repeated(Event):
    """The stage, which was done, is done again, because its artifact was damaged."""


@dataclass(frozen=True)
class Failed(Event):
    """The scene is left out for this ``reason``; ``trace`` is the traceback of a defect."""

    reason: str
    trace: str = ""


Listener = Callable[[Event], None]
"""Who hears of events."""
