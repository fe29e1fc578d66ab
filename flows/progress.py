"""What people see while a run works: little, on standard error, and how long is left."""

from __future__ import annotations

import sys
import time
from typing import TextIO

REMIND = 30.0
"""Seconds between progress lines where there is no terminal to keep one live line on."""


class Progress:
    """One line a scene as it is done, a live line in between, and a line a stage at the end.

    With ``verbose`` every stage of every scene has its line, and unexpected errors their
    traceback.
    """

    def __init__(
        self,
        scenes: int,
        stages: int,
        more: int = 0,
        verbose: bool = False,
        stream: TextIO | None = None,
    ) -> None:
        """``stages`` are those of each scene, ``more`` those of the whole run."""
        self.scenes, self.stages = scenes, stages
        self.total = scenes * stages + more
        self.verbose = verbose
        self.stream = stream or sys.stderr
        self.live = self.stream.isatty()
        self.start = self.last = time.perf_counter()
        self.steps = self.computed = self.lost = 0
        self.active: dict[str, str] = {}
        self.detail = ""
        self.done: dict[str, list[tuple[str, float, bool]]] = {}
        self.totals: dict[str, list[tuple[float, bool]]] = {}

    def started(self, scene: str, stage: str) -> None:
        """A stage of a scene begins."""
        self.active[scene] = stage
        self.detail = ""
        self._status()

    def said(self, scene: str, stage: str, text: str) -> None:
        """A stage that is being worked on is so far."""
        self.detail = f", {text}"
        self._status()

    def finished(self, scene: str, stage: str, seconds: float, cached: bool) -> None:
        """A stage of a scene is done, or was found done."""
        self.active.pop(scene, None)
        self.steps += 1
        self.computed += not cached
        self.totals.setdefault(stage, []).append((seconds, cached))
        mine = self.done.setdefault(scene, [])
        mine.append((stage, seconds, cached))
        if self.verbose or self.scenes == 1:
            self.line(f"{scene}  {stage}  {_took(seconds, cached)}")
        elif len(mine) == self.stages:
            computed = [(name, s) for name, s, was_cached in mine if not was_cached]
            told = " · ".join(f"{name} {s:.1f} s" for name, s in computed)
            rest = len(mine) - len(computed)
            cached_too = f"{rest} stages cached" if rest else ""
            self.line(f"{scene}  {' · '.join(filter(None, [told, cached_too]))}")
        self._status()

    def went_back(self, scene: str, stage: str, stages: int, reason: str) -> None:
        """The last stages of a scene that were done are done again."""
        self.active.pop(scene, None)
        del self.done[scene][-stages:]
        self.steps -= stages
        self.line(f"{scene}  goes {stages} stages back: {reason}")

    def dropped(self, scene: str) -> None:
        """A scene begins anew, whatever was done of it."""
        self.active.pop(scene, None)
        self.steps -= len(self.done.pop(scene, []))

    def failed(self, scene: str, stage: str, reason: str, trace: str = "") -> None:
        """A scene is taken out; ``trace`` is the traceback of an error that is a defect."""
        self.active.pop(scene, None)
        self.lost += 1
        self.total -= self.stages - len(self.done.get(scene, []))
        self.line(f"{scene}  left out at {stage}: {reason}")
        if self.verbose and trace:
            self.line(trace)

    def summary(self) -> None:
        """One line a stage with its time, then the whole."""
        self._clear()
        if self.scenes > 1:
            for stage, runs in self.totals.items():
                seconds, cached = sum(s for s, c in runs if not c), sum(c for _, c in runs)
                computed = len(runs) - cached
                told = [f"{computed} in {seconds:.1f} s" if computed else ""]
                told.append(f"{cached} cached" if cached else "")
                self.line(f"{stage:<12} {', '.join(filter(None, told))}")
        self.line(f"{'all':<12} {time.perf_counter() - self.start:.1f} s")

    def line(self, text: str) -> None:
        """A line that stays."""
        self._clear()
        self.stream.write(text + "\n")
        self.stream.flush()

    def _status(self) -> None:
        now = time.perf_counter()
        if not self.active or (not self.live and now - self.last < REMIND):
            return
        self.last = now
        doing = ", ".join(f"{scene}: {stage}" for scene, stage in self.active.items())
        told = f"{self.steps}/{self.total} stages{_rate(self, now)}  {doing}{self.detail}"
        if self.live:
            self.stream.write(f"\r\x1b[2K{told[:110]}")
            self.stream.flush()
        else:
            self.line(told)

    def _clear(self) -> None:
        if self.live:
            self.stream.write("\r\x1b[2K")


def _took(seconds: float, cached: bool) -> str:
    return "cached" if cached else f"{seconds:.1f} s"


def _rate(progress: Progress, now: float) -> str:
    """How fast, and for how long: the stages still to come take as long as their like so far.

    So where those of a kind were in the store, the next are taken to be, too. Of a single scene
    nothing is known before, as no stage of it is like another.
    """
    totals = progress.totals
    worked = {stage: sum(s for s, cached in runs if not cached) for stage, runs in totals.items()}
    if progress.scenes == 1 or not any(worked.values()):
        return ""
    elapsed = now - progress.start
    scenes = progress.scenes - progress.lost
    left, unseen = 0.0, progress.total - progress.steps
    for stage, runs in totals.items():
        more = max(0, scenes - len(runs))
        left += more * worked[stage] / len(runs)
        unseen -= more
    left += max(0, unseen) * sum(worked.values()) / progress.computed
    # Workers side by side do more than a second of work a second.
    left *= elapsed / sum(worked.values())
    return f", {60 * progress.computed / elapsed:.0f} a minute, about {left:.0f} s left"
