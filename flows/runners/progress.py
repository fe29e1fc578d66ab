"""Progress of a run: one line for each scene, and a bar with counts, rate and remaining time."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress
from rich.table import Column

from flows.runners import logger
from slgaussian.errors import one_line
from tasks.context import StageEvent

REMIND = 30.0
"""Seconds between lines with counts, in the log and without a terminal."""


class Progress:
    """Counter of a run's scenes and stages, displayed on a stream and logged.

    A context manager that updates a bar on a terminal, and elsewhere prints a line every
    :data:`REMIND` seconds.

    Parameters
    ----------
    scenes, stages : int
        Number of scenes, and of stages of each scene.
    verbose : bool
        Print a line for every stage, and tracebacks of unexpected errors.
    stream : text stream, optional
        Standard error by default.
    unit : str
        Plural noun for scenes.
    """

    def __init__(
        self,
        scenes: int,
        stages: int,
        verbose: bool = False,
        stream: TextIO | None = None,
        unit: str = "scenes",
    ) -> None:
        self.scenes, self.stages, self.unit, self.verbose = scenes, stages, unit, verbose
        self.steps, self.total = 0, scenes * stages
        self.done, self.failed = 0, 0
        self.console = console(stream)
        self.start = time.perf_counter()
        self.active: dict[str, str] = {}
        self.message = ""
        self.of_scene: defaultdict[str, list[StageEvent]] = defaultdict(list)
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.computed: Counter[str] = Counter()
        self.cached: Counter[str] = Counter()
        self.over = threading.Event()
        line = Column(ratio=1, no_wrap=True, overflow="ellipsis")
        self.bar = RichProgress(
            TextColumn("{task.description}", markup=False, table_column=line),
            BarColumn(20),
            TimeRemainingColumn(compact=True),
            console=self.console,
            transient=True,
            expand=True,
            disable=not self.console.is_terminal,
        )
        self.bar_task = self.bar.add_task("", total=self.total)

    def __enter__(self) -> Progress:
        logger.info("%d %s, %d stages", self.scenes, self.unit, self.total)
        self.bar.start()
        threading.Thread(target=self._remind, daemon=True).start()
        return self

    def __exit__(self, *error: object) -> None:
        self.over.set()
        self.bar.stop()
        logger.info(self.counts())

    def update(self, event: StageEvent) -> None:
        """Count and display a change of state of a stage."""
        scene, stage = event.scene, event.stage
        match event.state:
            case "running":
                self.active[scene], self.message = stage, event.message
            case "completed" | "cached":
                self._finished(event)
            case "repeated":
                text = f"{scene}  {stage}  again: its artifact was damaged"
                logger.warning(text)
                self.line(text)
                self.steps -= 1
                done = self.of_scene[scene]
                done.remove(next(earlier for earlier in done if earlier.stage == stage))
            case "failed":
                self._failed(event)
        self._show()

    def lost(self, event_text: str, scenes: Sequence[str]) -> None:
        """Report a worker that died or raised an error, and uncount its scenes."""
        text = f"a worker {event_text}; its scenes are tried again, one at a time"
        logger.warning("%s: %s", text, ", ".join(scenes))
        for scene in scenes:
            self.active.pop(scene, None)
            self.steps -= len(self.of_scene.pop(scene, ()))
        self.line(text)

    def line(self, text: str) -> None:
        """Print a permanent line; control characters are escaped."""
        for part in text.split("\n"):
            self.console.print(one_line(part))

    def note(self, text: str) -> None:
        """Print and log a line about the whole run."""
        logger.info(text)
        self.line(text)

    def summary(self) -> None:
        """Print the time of each stage, and the total."""
        if self.scenes > 1:
            for stage in self.seconds:
                computed, cached = self.computed[stage], self.cached[stage]
                texts = [f"{computed} in {self.seconds[stage]:.1f} s"] if computed else []
                texts += [f"{cached} cached"] if cached else []
                self.line(f"{stage:<12} {', '.join(texts)}")
        self.line(f"{'all':<12} {time.perf_counter() - self.start:.1f} s")

    def counts(self) -> str:
        """Return counts and rate in a line."""
        elapsed = max(1e-3, time.perf_counter() - self.start)
        texts = [f"{self.done}/{self.scenes} {self.unit}"] if self.scenes > 1 else []
        texts += [f"{self.failed} failed"] if self.failed else []
        texts.append(f"{self.steps}/{self.total} stages")
        if self.scenes > 1 and self.done:
            texts.append(f"{60 * self.done / elapsed:.3g} {self.unit} a minute")
        return ", ".join(texts)

    def _finished(self, event: StageEvent) -> None:
        scene, stage, cached = event.scene, event.stage, event.state == "cached"
        text = f"{scene}  {stage}  {'cached' if cached else f'{event.seconds:.1f} s'}"
        logger.log(logging.DEBUG if cached else logging.INFO, text)
        self.active.pop(scene, None)
        self.steps += 1
        (self.cached if cached else self.computed)[stage] += 1
        self.seconds[stage] += 0.0 if cached else event.seconds
        self.of_scene[scene].append(event)
        if self.verbose or self.scenes == 1:
            self.line(text)
        if len(self.of_scene[scene]) == self.stages:
            self._went_through(scene)

    def _went_through(self, scene: str) -> None:
        events = self.of_scene[scene]
        computed = [event for event in events if event.state != "cached"]
        rest = len(events) - len(computed)
        texts = [" · ".join(f"{event.stage} {event.seconds:.1f} s" for event in computed)]
        texts += [f"{rest} stages cached"] if rest else []
        self.done += 1
        if not self.verbose and self.scenes > 1:
            self.line(f"{scene}  {' · '.join(filter(None, texts))}")

    def _failed(self, event: StageEvent) -> None:
        scene, stage = event.scene, event.stage
        text = f"{scene}  left out at {stage}: {event.message}"
        logger.error("\n".join(filter(None, (text, event.traceback))))
        self.active.pop(scene, None)
        self.failed += 1
        self.total -= self.stages - len(self.of_scene[scene])
        self.say_failed(text, event.traceback)

    def say_failed(self, text: str, traceback: str) -> None:
        """Print that a scene was left out."""
        self.line(text)
        if self.verbose and traceback:
            self.line(traceback)

    def _working(self) -> str:
        stages = ", ".join(f"{scene}: {stage}" for scene, stage in list(self.active.items()))
        return one_line(f"{stages}, {self.message}" if self.message else stages)

    def _show(self) -> None:
        text = f"{self.counts()}  {self._working()}"
        self.bar.update(self.bar_task, completed=self.steps, total=self.total, description=text)

    def _remind(self) -> None:
        while not self.over.wait(REMIND):
            logger.info(self.counts())
            if not self.console.is_terminal:
                self.line(f"{self.counts()}  {self._working()}".rstrip())


def console(stream: TextIO | None = None) -> Console:
    """Return a console without markup on a stream, standard error by default."""
    return Console(
        file=stream or sys.stderr, markup=False, highlight=False, emoji=False, soft_wrap=True
    )
