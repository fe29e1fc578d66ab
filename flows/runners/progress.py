"""What people and logs are told while a run works, and how long is left."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TextIO

from flows.runners.display import Display
from flows.runners.journal import log
from flows.runners.memory import memory_in_use
from flows.runners.metrics import Metrics
from tasks.events import Event, Failed, Finished, Repeated, Said, Started

REMIND = 30.0
"""Seconds between lines with the metrics: in the log, and where there is no terminal to keep a
table on."""

REDRAW = 0.1
"""Seconds at least between two drawings of the table: there may be thousands of events a second."""

TICK = 1.0
"""Seconds at most."""


@dataclass
class Spent:
    """What a stage took, of all scenes so far: how often it was done or found done, and seconds."""

    computed: int = 0
    cached: int = 0
    seconds: float = 0.0


class Progress:
    """One line a scene as it is done, a table in between, and a line a stage at the end.

    With ``verbose`` every stage of every scene has its line, and unexpected errors their
    traceback. Within ``with`` it also tells the metrics while nothing happens.
    """

    def __init__(
        self,
        scenes: int,
        stages: int,
        verbose: bool = False,
        stream: TextIO | None = None,
        unit: str = "scenes",
    ) -> None:
        """``stages`` are those of each scene."""
        self.scenes, self.stages, self.unit = scenes, stages, unit
        self.total = scenes * stages
        self.verbose = verbose
        self.display = Display(stream or sys.stderr)
        self.start = self.reminded = self.drawn = time.perf_counter()
        self.steps = 0
        self.active: dict[str, str] = {}
        self.detail = ""
        self.under_way: dict[str, list[tuple[str, float, bool]]] = {}
        self.whole: set[str] = set()
        self.left_out: dict[str, int] = {}
        self.spent: dict[str, Spent] = {}
        self.memory = self.peak = memory_in_use()
        self.lock = threading.RLock()
        self.over = threading.Event()

    def __enter__(self) -> Progress:
        told = f"{self.scenes} {self.unit}, {self.total} stages"
        log(logging.INFO, "began", told, unit=self.unit, scenes=self.scenes, stages=self.total)
        threading.Thread(target=self._tick, daemon=True).start()
        return self

    def __exit__(self, *error: object) -> None:
        with self.lock:
            self.over.set()
            self.display.clear()
        self._log_metrics()

    def hear(self, event: Event) -> None:
        """Tell of something that happened to a scene."""
        scene, stage = event.scene, event.stage
        match event:
            case Started():
                self._started(scene, stage)
            case Said(text=text):
                self._said(scene, stage, text)
            case Finished(seconds=seconds, cached=cached):
                self._finished(scene, stage, seconds, cached)
            case Repeated():
                self._repeated(scene, stage)
            case Failed(reason=reason, trace=trace):
                self._failed(scene, stage, reason, trace)

    def _started(self, scene: str, stage: str) -> None:
        """A stage of a scene begins."""
        log(logging.DEBUG, "started", f"{scene}  {stage}", scene=scene, stage=stage)
        with self.lock:
            self.active[scene] = stage
            self.detail = ""
        self._status()

    def _said(self, scene: str, stage: str, text: str) -> None:
        """A stage that is being worked on is so far."""
        log(logging.DEBUG, "said", f"{scene}  {stage}  {text}", scene=scene, stage=stage)
        with self.lock:
            self.detail = f", {text}" if text else ""
        self._status()

    def _finished(self, scene: str, stage: str, seconds: float, cached: bool) -> None:
        """A stage of a scene is done, or was found done."""
        told = f"{scene}  {stage}  {'cached' if cached else f'{seconds:.1f} s'}"
        level, took = logging.DEBUG if cached else logging.INFO, round(seconds, 3)
        log(level, "finished", told, scene=scene, stage=stage, seconds=took, cached=cached)
        with self.lock:
            self.active.pop(scene, None)
            self.steps += 1
            spent = self.spent.setdefault(stage, Spent())
            spent.cached += cached
            spent.computed += not cached
            spent.seconds += 0.0 if cached else seconds
            mine = self.under_way.setdefault(scene, [])
            mine.append((stage, seconds, cached))
            if self.verbose or self.scenes == 1:
                self.display.line(told)
            if len(mine) == self.stages:
                self._went_through(scene)
        self._status()

    def _repeated(self, scene: str, stage: str) -> None:
        """A stage of a scene that was done has been done again; it is counted once."""
        told = f"{scene}  {stage}  again: its artifact was damaged"
        log(logging.WARNING, "repeated", told, scene=scene, stage=stage)
        with self.lock:
            mine = self.under_way[scene]
            mine.remove(next(one for one in mine if one[0] == stage))
            self.steps -= 1
            self.display.line(told)

    def dropped(self, scene: str) -> None:
        """A scene begins anew, whatever was done of it."""
        log(logging.WARNING, "dropped", f"{scene}  begins anew", scene=scene)
        with self.lock:
            self.active.pop(scene, None)
            self.steps -= len(self.under_way.pop(scene, []))
            if scene in self.whole:
                self.whole.remove(scene)
                self.steps -= self.stages
            if scene in self.left_out:
                done = self.left_out.pop(scene)
                self.steps -= done
                self.total += self.stages - done

    def _failed(self, scene: str, stage: str, reason: str, trace: str) -> None:
        """A scene is taken out."""
        told = f"{scene}  left out at {stage}: {reason}"
        more: dict[str, Any] = {"traceback": trace} if trace else {}
        log(logging.ERROR, "failed", told, scene=scene, stage=stage, reason=reason, **more)
        with self.lock:
            self.active.pop(scene, None)
            self.left_out[scene] = len(self.under_way.pop(scene, []))
            self.total -= self.stages - self.left_out[scene]
            self.say_failed(told, trace)

    def lost(self, died: bool, how: str, scenes: Sequence[str]) -> None:
        """A worker ``died`` or raised an error, with all that it had not told of these scenes."""
        told = f"a worker {how}; its scenes are tried again"
        event = "worker_died" if died else "worker_raised"
        log(logging.WARNING, event, told, reason=how, scenes=list(scenes))
        with self.lock:
            self.display.line(told)

    def say_failed(self, told: str, trace: str) -> None:
        """How people are told that a scene was left out."""
        self.display.line(told)
        if self.verbose and trace:
            self.display.line(trace)

    def line(self, text: str) -> None:
        """A line that stays, about the whole run."""
        log(logging.INFO, "note", text)
        with self.lock:
            self.display.line(text)

    def summary(self) -> None:
        """One line a stage with its time, then the whole."""
        with self.lock:
            self.display.clear()
            if self.scenes > 1:
                for stage, spent in self.spent.items():
                    told = [f"{spent.computed} in {spent.seconds:.1f} s"] if spent.computed else []
                    told += [f"{spent.cached} cached"] if spent.cached else []
                    self.display.line(f"{stage:<12} {', '.join(told)}")
            self.display.line(f"{'all':<12} {time.perf_counter() - self.start:.1f} s")

    def metrics(self, now: float | None = None) -> Metrics:
        """The run in numbers so far; ``now`` is by ``time.perf_counter``."""
        elapsed = max(1e-3, (time.perf_counter() if now is None else now) - self.start)
        spent = self.spent.values()
        return Metrics(
            unit=self.unit,
            done=len(self.whole),
            failed=len(self.left_out),
            scenes=self.scenes,
            steps=self.steps,
            stages=self.total,
            computed=sum(stage.computed for stage in spent),
            cached=sum(stage.cached for stage in spent),
            rate=60 * len(self.whole) / elapsed,
            left=self._left(elapsed),
            memory=self.memory,
            peak=self.peak,
        )

    def _went_through(self, scene: str) -> None:
        mine = self.under_way.pop(scene)
        self.whole.add(scene)
        computed = [(stage, seconds) for stage, seconds, cached in mine if not cached]
        rest = len(mine) - len(computed)
        told = [" · ".join(f"{stage} {seconds:.1f} s" for stage, seconds in computed)]
        told += [f"{rest} stages cached"] if rest else []
        said = f"{scene}  {' · '.join(filter(None, told))}"
        took, worked = round(sum(seconds for _, seconds, _ in mine), 3), len(computed)
        log(logging.INFO, "done", said, scene=scene, seconds=took, computed=worked, cached=rest)
        if not self.verbose and self.scenes > 1:
            self.display.line(said)

    def _left(self, elapsed: float) -> float | None:
        """Seconds to go: the stages still to come take as long as their like so far.

        So where those of a kind were in the store, the next are taken to be, too. Of a single scene
        nothing is known before, as no stage of it is like another.
        """
        worked = sum(stage.seconds for stage in self.spent.values())
        if self.scenes == 1 or not worked:
            return None
        left, unseen = 0.0, self.total - self.steps
        for stage in self.spent.values():
            runs = stage.computed + stage.cached
            more = min(unseen, max(0, self.scenes - len(self.left_out) - runs))
            left += more * stage.seconds / runs
            unseen -= more
        left += unseen * worked / sum(stage.computed for stage in self.spent.values())
        # Workers side by side do more than a second of work a second.
        return left * elapsed / worked

    def _status(self) -> None:
        now = time.perf_counter()
        live = self.display.live
        if now - (self.drawn if live else self.reminded) < (REDRAW if live else REMIND):
            return
        with self.lock:
            if self.over.is_set():
                return
            working = ", ".join(f"{scene}: {stage}" for scene, stage in self.active.items())
            working += self.detail
            if live:
                self.drawn = now
                self.display.table(self.metrics(now).cells(), working)
            else:
                self.reminded = now
                self.display.line(f"{self.metrics(now).sentence()}  {working}".rstrip())

    def _tick(self) -> None:
        logged = time.perf_counter()
        while not self.over.wait(TICK):
            self.memory = memory_in_use()
            self.peak = max(self.memory, self.peak)
            self._status()
            if time.perf_counter() - logged > REMIND:
                logged = time.perf_counter()
                self._log_metrics()

    def _log_metrics(self) -> None:
        with self.lock:
            metrics, working = self.metrics(), dict(self.active)
        facts: dict[str, Any] = {
            k: round(v, 1) if type(v) is float else v for k, v in vars(metrics).items()
        }
        log(logging.INFO, "metrics", metrics.sentence(), **facts, working=working)
