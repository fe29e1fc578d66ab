"""Serve the retraining flow by the clock, from one process; ``prefect.yaml`` is for work pools."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import signal
import sys
import urllib.request
from typing import Any

from prefect.client.schemas.schedules import CronSchedule
from prefect.flows import EntrypointType
from prefect.runner import Runner
from pydantic import ValidationError

from flows.config import RetrainSettings
from flows.read_config import anchored_config
from flows.retraining import retrain
from flows.runners.server import import_path
from slgaussian.errors import InputError


def serve(config: RetrainSettings, every: float | None, cron: str | None) -> None:
    """Wait for the times of a schedule and retrain at each, one at a time, until stopped.

    Parameters
    ----------
    config : RetrainSettings
        Parameters of the deployment; Prefect's page can change them.
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
        raise InputError("retrain: --every and --cron are two ways; choose one")
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
    print(f"retrain {times}, by {_server()}; stop with Ctrl-C", file=sys.stderr, flush=True)
    runner = _Runner(name=retrain.name, limit=1)
    runner.add_flow(
        retrain,
        name=retrain.name,
        interval=every,
        cron=cron,
        parameters={"config": anchored_config(config).model_dump(mode="json", exclude_unset=True)},
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
        # Prefect's leaves the schedule running, and waits for a run until that is done.
        signal.raise_signal(signal.SIGINT)


def _server() -> str:
    url = os.environ.get("PREFECT_API_URL")
    if not url:
        raise InputError(
            "a schedule needs a Prefect server that keeps running: start one with `prefect server "
            "start`, set PREFECT_API_URL=http://127.0.0.1:4200/api and run this again; or let cron "
            "run `slgaussian retrain` without --every and --cron"
        )
    try:
        urllib.request.urlopen(f"{url}/health", timeout=30).close()
    except (OSError, ValueError) as error:
        raise InputError(
            f"PREFECT_API_URL {url}: no Prefect server answers there ({error}); start it with "
            "`prefect server start`"
        ) from error
    return url
