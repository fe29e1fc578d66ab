"""Common frame of flows: provenance, damaged artifacts, final state, Prefect artifacts."""

from __future__ import annotations

import errno
import logging
import os
import platform
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar
from uuid import UUID

from prefect import artifacts
from prefect.client.orchestration import get_client
from prefect.client.schemas.filters import FlowRunFilter, TaskRunFilter
from prefect.events.worker import EventsWorker
from prefect.logging.handlers import APILogHandler
from prefect.runtime import deployment, flow_run
from prefect.states import Cancelled, State

from flows.config import Engine
from flows.runners import logger
from flows.runners.batches import TooManyFailuresError, write_failures
from flows.runners.task_runners import NO_EVENTS
from slgaussian import __version__
from slgaussian.benchmark.mlflow_log import log_results
from slgaussian.errors import InputError, SLGaussianError, did_you_mean
from slgaussian.io import write_atomic
from slgaussian.storage.provenance import Provenance, record_provenance
from slgaussian.storage.store import ArtifactStore, DamagedError

Result = TypeVar("Result")
Config = TypeVar("Config", bound=Any)

RESULTS: list[Any] = []
"""Result of the last flow of this process, even if the server has not received it."""

CLOSE_TIMEOUT = 5.0
"""Longest time to wait for events on their way to the server when a run is stopped, seconds."""

MAX_ROWS = 500
"""Largest number of rows of a table artifact, which Prefect shows on one page."""


def run_session(
    command: str,
    config: Config,
    work: Callable[[Config, ArtifactStore, bool], Result],
    verbose: bool,
) -> Result:
    """Do the work of a flow with its configuration and store, and repair damaged artifacts.

    An artifact that is found damaged is removed, and the work is repeated: that recomputes the
    artifact and finds the others in the store. A signal closes the tasks on an external server.

    Args:
        command: Name of the command, for provenance.
        config: The flow's configuration, with ``store`` and ``out`` at least.

    Raises:
        SLGaussianError: As ``work``, and if a damaged artifact is not recomputed by it.
    """
    store = ArtifactStore(config.store)
    if deployment.id is not None:
        threading.Thread(target=_exit_with_parent, args=(os.getppid(),), daemon=True).start()
    damaged = dict[str, str]()
    check_folder(config.out)
    _tag_run(command, dict(config))
    with record_provenance(Provenance(command)):
        while True:
            try:
                result = work(config, store, verbose)
                if message := log_results(command, config.out, getattr(config, "models", None)):
                    logger.warning(message)
                    print(f"warning: {message}", file=sys.stderr)
                return result
            except DamagedError as error:
                if error.uri in damaged:
                    raise InputError(
                        f"{damaged[error.uri]}; this command does not make it: first run the one "
                        "that does, such as `slgaussian supervise`"
                    ) from error
                damaged[error.uri] = str(error)
                store.remove([error.uri])
                message = (
                    f"{store.root}/{error.uri} is damaged; it is removed, and the work begins anew"
                )
                logger.warning(message)
                print(message, file=sys.stderr, flush=True)
            except TooManyFailuresError as error:
                with writing(config.out):
                    write_failures(config.out, error.failures)
                raise
            except BaseException as error:
                if not isinstance(error, Exception):  # a signal
                    _close_tasks()
                    if deployment.id is not None:
                        # As Prefect does; functions of `atexit` come after the threads' end.
                        threading._register_atexit(_exit_at_once)  # type: ignore[attr-defined]
                raise


def _tag_run(command: str, values: dict[str, Any]) -> None:
    """Tag the flow run on an external server with command, version and names of its data."""
    if NO_EVENTS in os.environ:
        return
    places = [*values.get("sources", ()), values.get("data"), values.get("lessons")]
    data = {Path(str(place)).name for place in places if place is not None}
    data |= {scene.dataset for scene in values.get("scenes", ())}
    # `prefect.tags` would be on its tasks too, each of which then asks for the limits of its tags.
    with get_client(sync_client=True) as client:
        tags = {*flow_run.tags, command, f"slgaussian {__version__}", *data}
        client.update_flow_run(UUID(flow_run.id), tags=tags)


def _exit_with_parent(parent: int) -> None:
    """End this process when the process that serves its deployment is gone."""
    while os.getppid() == parent:
        time.sleep(1)
    os._exit(1)


def _close_tasks() -> None:
    """Cancel the open tasks of this flow on an external server, since nobody waits for them."""
    if NO_EVENTS in os.environ:
        return
    EventsWorker.drain_all(timeout=CLOSE_TIMEOUT)  # else a task that starts now may follow
    try:
        with get_client(sync_client=True) as client:
            ours = FlowRunFilter.model_validate({"id": {"any_": [flow_run.id]}})
            is_open = {"state": {"type": {"any_": ["PENDING", "RUNNING"]}}}
            open_tasks = TaskRunFilter.model_validate(is_open)
            for task_run in client.read_task_runs(flow_run_filter=ours, task_run_filter=open_tasks):
                state: State[Any] = Cancelled(message="the run was stopped")
                client.set_task_run_state(task_run.id, state, force=True)
    except Exception as error:  # the server may have stopped too
        logger.warning("the tasks of the run stay open on the server: %s", error)


def _exit_at_once() -> None:
    """End the process before the interpreter waits for threads that still compute."""
    logging.disable()  # what they log from now on is that the interpreter ends
    EventsWorker.drain_all(timeout=CLOSE_TIMEOUT)
    APILogHandler().flush()
    os._exit(128 + signal.SIGTERM)


def final(state: State[Result]) -> State[Result]:
    """Record the result of a final state; one that is not Completed then raises its message."""
    RESULTS[:] = [state.data]
    if not state.is_completed():
        state.data = SLGaussianError(state.message or "")
    return state


def check_refresh(config: Engine, stages: Sequence[str]) -> None:
    """Raise InputError if an element of ``config.refresh`` is no stage of the flow."""
    for name in config.refresh:
        if name not in stages:
            raise InputError(
                f"refresh: found {name!r}, expected one of the stages {', '.join(stages)}"
                f"{did_you_mean(name, stages)}"
            )


@contextmanager
def writing(out: Path) -> Iterator[None]:
    """Convert OSError within the block, which writes results, to InputError."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            reason = f"the disk of the output folder is full: {reason}"
        raise InputError(
            f"{out}: cannot write the results ({reason}); they are kept in the "
            "store, so make room there, or choose another folder with -o, and run again"
        ) from error


def check_folder(out: Path) -> None:
    """Make the output folder and test that it is writable; InputError if not."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_atomic(out / ".probe", b"")
        (out / ".probe").unlink()
    except OSError as error:
        raise InputError(
            f"{out}: cannot write there ({error.strerror}); choose another folder with -o"
        ) from error


def publish(key: str, content: str | Path | Sequence[dict[str, Any]], description: str) -> None:
    """Create a Prefect artifact on an external server; our own ends with the command.

    Args:
        key: Lower-case letters, digits and dashes.
        content: Markdown, a file to link to, or a table, of which the first :data:`MAX_ROWS` rows
            are used.
        description: A phrase in Markdown.
    """
    if NO_EVENTS in os.environ:
        return
    try:
        if isinstance(content, Path):
            file, machine = content.resolve(), platform.node()
            artifacts.create_link_artifact(
                file.as_uri(), file.name, key, f"{description}: `{file}` on {machine}"
            )
        elif isinstance(content, str):
            artifacts.create_markdown_artifact(content, key, description)
        else:
            artifacts.create_table_artifact(list(content[:MAX_ROWS]), key, description)
    except Exception as error:  # the run continues without its artifact
        logger.warning("an artifact was not created: %s", error)
