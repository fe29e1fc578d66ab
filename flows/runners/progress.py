"""Progress of a run: a line for each finished scene, and a bar with rate and remaining time."""

from __future__ import annotations

import logging
import os
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from typing import Any, TextIO

from prefect.artifacts import create_progress_artifact, update_progress_artifact
from prefect.runtime import flow_run
from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress
from rich.table import Column

from flows.runners import logger
from flows.runners.task_runners import NO_EVENTS
from slgaussian.errors import one_line
from tasks.context import StageEvent

MESSAGE_SECONDS = 30.0
"""Seconds without a line, after which a long stage's message is one, without a terminal."""

PUBLISH_SECONDS = 5.0
"""Smallest time between two updates of the Prefect artifact, each of which costs some 20 ms."""

ARTIFACTS: dict[str, Any] = {}
"""Id of the Prefect artifact of progress of each flow run of this process."""


class Progress:
    """Counter of a run's scenes and stages, displayed on a stream and logged.

    A context manager that shows a bar on a terminal, and prints a line at its end.

    Args:
        scenes, stages: Number of scenes, and of stages of each scene.
        verbose: Print a line for every stage, and tracebacks of unexpected errors.
        stream: text stream, optional. Standard error by default.
        unit: Plural noun for scenes.
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
        self.steps, self.total, self.done, self.failed = 0, scenes * stages, 0, 0
        self.console = Console(
            file=stream or sys.stderr, markup=False, highlight=False, emoji=False, soft_wrap=True
        )
        self.start = self.last_line = self.publish_at = time.perf_counter()
        self.active: dict[str, str] = {}
        self.of_scene: defaultdict[str, list[StageEvent]] = defaultdict(list)
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
        self.bar.start()
        self._publish()
        return self

    def __exit__(self, error: object, *_: object) -> None:
        self.bar.stop()
        if error is None:
            seconds = f"{time.perf_counter() - self.start:.1f} s in all"
            self.line(", ".join([*self._counts(), seconds]))
            self.publish_at = 0.0
            self._publish()

    def update(self, event: StageEvent) -> None:
        """Count and display a change of state of a stage."""
        scene = event.scene
        if event.state == "running":
            text = f"{scene}: {event.stage}" + (f" ({event.message})" if event.message else "")
            self.active[scene] = text
            silent = time.perf_counter() - self.last_line
            if event.message and silent > MESSAGE_SECONDS and not self.console.is_terminal:
                self.line(text)
        else:
            self.active.pop(scene, None)
            (self._count_failure if event.state == "failed" else self._count_stage)(event)
        texts = self._counts()
        if self.scenes > 1 and self.done:
            rate = 60 * self.done / (time.perf_counter() - self.start)
            texts.append(f"{rate:.3g} {self.unit} a minute")
        text = one_line(", ".join([*texts, *self.active.values()]))
        self.bar.update(self.bar_task, completed=self.steps, total=self.total, description=text)
        self._publish()

    def lost(self, event_text: str, scenes: Sequence[str]) -> None:
        """Report a worker that died or raised an error, and uncount its scenes."""
        for scene in scenes:
            self.active.pop(scene, None)
            stages = len(self.of_scene.pop(scene, ()))
            self.steps -= stages
            self.done -= stages == self.stages
        self.line(
            f"a worker {event_text}; its scenes are tried again, one at a time: "
            f"{', '.join(scenes)}",
            logging.WARNING,
        )

    def line(self, text: str, level: int = logging.INFO) -> None:
        """Print and log permanent lines; control characters are escaped."""
        logger.log(level, text)
        self.last_line = time.perf_counter()
        for part in text.split("\n"):
            self.console.print(one_line(part))

    def _publish(self) -> None:
        """Update the Prefect artifact of the flow run on an external server, when it is time."""
        now = time.perf_counter()
        if now < self.publish_at or NO_EVENTS in os.environ or (run := flow_run.id) is None:
            return
        self.publish_at = now + PUBLISH_SECONDS
        share = 100.0 * self.steps / self.total if self.total else 100.0
        text = ", ".join(self._counts() or [f"{self.steps}/{self.total} stages"])
        try:
            if run in ARTIFACTS:
                update_progress_artifact(ARTIFACTS[run], share, text)
            else:
                ARTIFACTS[run] = create_progress_artifact(share, "slgaussian-progress", text)
        except Exception as error:  # the run continues without its artifact
            logger.warning("the artifact of progress was not updated: %s", error)

    def _counts(self) -> list[str]:
        failed = [f"{self.failed} failed"] if self.failed else []
        return [f"{self.done}/{self.scenes} {self.unit}", *failed] if self.scenes > 1 else []

    def _count_stage(self, event: StageEvent) -> None:
        scene, cached = event.scene, event.state == "cached"
        self.steps += 1
        events = self.of_scene[scene]
        events.append(event)
        self.done += len(events) == self.stages
        if self.verbose or self.scenes == 1:
            self.line(f"{scene}  {event.stage}  {'cached' if cached else f'{event.seconds:.1f} s'}")
        elif len(events) == self.stages:
            computed = [event for event in events if event.state != "cached"]
            texts = [f"{event.stage} {event.seconds:.1f} s" for event in computed]
            if rest := len(events) - len(computed):
                texts.append(f"{rest} stages cached")
            self.line(f"{scene}  {' · '.join(texts)}")

    def _count_failure(self, event: StageEvent) -> None:
        self.failed += 1
        self.total -= self.stages - len(self.of_scene[event.scene])
        self.line(f"{event.scene}  left out at {event.stage}: {event.message}", logging.ERROR)
        if event.traceback:
            (self.line if self.verbose else logger.error)(event.traceback)
