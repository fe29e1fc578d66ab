"""What a Prefect server and its workers start by the clock: nights, reports, lessons."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import signal
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from prefect import flow
from prefect.client.schemas.schedules import CronSchedule
from prefect.events import emit_event
from prefect.flows import EntrypointType
from prefect.runner import Runner
from prefect.runtime import deployment
from prefect.states import Completed, State
from pydantic import ValidationError

from flows.corpus_settings import read_corpus
from flows.night_settings import read_night
from flows.runners.child import import_path
from flows.runners.commands import perform
from flows.runners.shard import Failure
from flows.settings import read_toml
from flows.training_settings import from_anywhere
from slgaussian.errors import InputError, SLGaussianError
from slgaussian.storage.locks import BusyError

NAME = "slgaussian-nightly"

NAMED = 50
"""Scenes that a message names at most."""


@flow(name=NAME, persist_result=False)
def nightly(config: str, given: dict[str, Any] | None = None) -> State:
    """What `slgaussian nightly` does, each time in a process of its own.

    The message of the run's state says what came of it.

    What came of it is an event of Prefect's too, ``slgaussian.night.promoted`` for example, which
    automations can wait for. A night that fails fails the run.

    Parameters
    ----------
    config : str
        TOML file, read anew each time.
    given : mapping, optional
        Settings that win over it.
    """
    file = Path(config)
    try:
        had = _performed("nightly", lambda: read_night(file, given or {}))
    except BusyError as error:
        return _completed(str(error))
    resource = {"prefect.resource.id": f"slgaussian.night.{file.stem}"}
    payload = {"said": list(had.said), "record": str(had.record)}
    emit_event(f"slgaussian.night.{had.outcome.replace(' ', '-')}", resource, payload=payload)
    return _completed(f"{'; '.join(had.said)}; {had.outcome}; record: {had.record}")


@flow(name="slgaussian-report", persist_result=False)
def report(config: str, given: dict[str, Any] | None = None) -> State:
    """What `slgaussian run` does, likewise: a benchmark and its report."""
    made = _performed("run", lambda: read_toml(Path(config), given or {}))
    return _completed(f"report: {made.report}" if made.report else "no report", made.failures)


@flow(name="slgaussian-supervise", persist_result=False)
def supervise(config: str, given: dict[str, Any] | None = None) -> State:
    """What `slgaussian supervise` does, likewise: what is new in a corpus is made into lessons."""
    made = _performed("supervise", lambda: read_corpus(Path(config), given or {}))
    return _completed(", ".join(f"{n} {stage}" for stage, n in made.rows.items()), made.failures)


def _performed(command: str, read: Callable[[], Any]) -> Any:
    if deployment.id is not None:
        threading.Thread(target=_leave_with_parent, args=(os.getppid(),), daemon=True).start()
    try:
        return perform(command, read())
    except SLGaussianError as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        raise


def _completed(message: str, failures: Sequence[Failure] = ()) -> State:
    """The state of a run that came to an end, whose message names the scenes that it left out."""
    names = list(dict.fromkeys(failure.scene for failure in failures))
    if names:
        more = f" and {len(names) - NAMED} more" if names[NAMED:] else ""
        message += f"; left out: {', '.join(names[:NAMED])}{more}"
    print(message, flush=True)
    return Completed(message=message)


def serve(config: Path, given: dict[str, Any], every: float | None, cron: str | None) -> None:
    """Wait for the times of a schedule and have a night at each, one at a time, until stopped.

    Parameters
    ----------
    config, given
        As :func:`flows.night_settings.read_night` takes them.
    every : float, optional
        Seconds between two times.
    cron : str, optional
        Times as cron writes them, in UTC. One of both.

    Raises
    ------
    InputError
        If it is not one of both, the times are none, or no Prefect server answers.
    """
    if (every is None) == (cron is None):
        raise InputError("nightly: --every and --cron are two ways; choose one")
    if every is not None and every <= 0:
        raise InputError(f"--every: found {every:g}, expected a number of seconds above 0")
    if cron is not None:
        try:
            CronSchedule(cron=cron)
        except ValidationError as error:
            raise InputError(
                f"--cron: found {cron!r}, expected five fields as in '0 3 * * *'"
            ) from error
    times = f"every {every:g} s" if cron is None else f"at {cron!r}, UTC"
    print(f"nightly {times}, by {_server()}; stop with Ctrl-C", file=sys.stderr, flush=True)
    runner = _Runner(name=NAME, limit=1)
    runner.add_flow(
        nightly,
        name=NAME,
        interval=every,
        cron=cron,
        parameters={
            "config": str(config.resolve()),
            "given": from_anywhere(config, given),
        },
        entrypoint_type=EntrypointType.MODULE_PATH,
    )
    # The runs it starts look for modules where we do, and not in the working folder.
    os.environ.update(import_path())
    try:
        asyncio.run(runner.start())
    except KeyboardInterrupt:
        # Python would wait for what they are at, a training of hours perhaps.
        for run in multiprocessing.active_children():
            run.kill()


class _Runner(Runner):
    def handle_sigterm(self, *args: Any) -> None:
        # Prefect's own leaves the schedule running, and waits for a run until that is done.
        signal.raise_signal(signal.SIGINT)


def _leave_with_parent(parent: int) -> None:
    """End this process, whose training goes on next time, once its parent is gone."""
    while os.getppid() == parent:
        time.sleep(1)
    os._exit(1)


def _server() -> str:
    url = os.environ.get("PREFECT_API_URL")
    if not url:
        raise InputError(
            "a schedule needs a Prefect server that keeps running: start one with `prefect server "
            "start`, set PREFECT_API_URL=http://127.0.0.1:4200/api and run this again; or let cron "
            "run `slgaussian nightly` without --every and --cron"
        )
    try:
        urllib.request.urlopen(f"{url}/health", timeout=30).close()
    except (OSError, ValueError) as error:
        raise InputError(
            f"PREFECT_API_URL {url}: no Prefect server answers there ({error}); start it with "
            "`prefect server start`"
        ) from error
    return url
