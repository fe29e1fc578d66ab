"""What every flow does around its work: log, provenance, damaged artifacts, Prefect artifacts."""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from prefect.artifacts import create_markdown_artifact, create_table_artifact
from prefect.runtime import deployment
from prefect.states import Completed, State

from flows.runners.batches import Failure
from flows.runners.log_file import log, log_to_file
from flows.runners.task_runners import NO_EVENTS
from slgaussian import __version__
from slgaussian.errors import InputError, did_you_mean
from slgaussian.io import write_atomic
from slgaussian.storage.provenance import Made, making
from slgaussian.storage.store import ArtifactStore, DamagedError

Result = TypeVar("Result")

RESULTS: list[Any] = []
"""The result of the last flow of this process, whether its server learnt of it or not."""

NAMED = 50
"""Scenes that the message of a state names at most."""

MOST_ROWS = 500
"""Rows of a table artifact at most: Prefect keeps it in a database and shows it on one page."""


def run_session(
    command: str, config: Any, verbose: bool, work: Callable[[ArtifactStore], Result]
) -> Result:
    """Do the work of a flow with its store, a log in its output folder, and whole artifacts.

    Where an artifact turns out to be damaged when it is handed out or read by another scene, it is
    removed and the work is done again, which computes it anew and finds the rest in the store.

    Parameters
    ----------
    command : str
        Name of the command, for provenance and log.
    config
        The flow's configuration, with ``store`` and ``out`` at least.
    verbose : bool
    work : callable

    Raises
    ------
    SLGaussianError
        As ``work``, and if a damaged artifact is none that it makes.
    """
    store = ArtifactStore(config.store)
    facts = config.model_dump(include={"runner", "workers"})
    facts |= {"command": command, "version": __version__, "store": store.root}
    if deployment.id is not None:
        threading.Thread(target=_leave_with_parent, args=(os.getppid(),), daemon=True).start()
    damaged: dict[str, str] = {}
    check_folder(config.out)
    with log_to_file(config.out, verbose, **facts), making(Made(command)):
        while True:
            try:
                return work(store)
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
                log(logging.WARNING, "damaged", message)
                print(message, file=sys.stderr, flush=True)


def _leave_with_parent(parent: int) -> None:
    """End this process, whose work goes on next time, once the one that serves it is gone."""
    while os.getppid() == parent:
        time.sleep(1)
    os._exit(1)


def completed(
    message: str, result: Result, failures: Sequence[Failure] = (), name: str = "Completed"
) -> State[Result]:
    """Return the final state of a flow, whose message names the scenes that were left out."""
    names = list(dict.fromkeys(failure.scene for failure in failures))
    if names:
        more = f" and {len(names) - NAMED} more" if names[NAMED:] else ""
        message += f"; left out: {', '.join(names[:NAMED])}{more}"
    RESULTS[:] = [result]
    return Completed(name=name, message=message, data=result)


def stages_to_refresh(config: Any, stages: Sequence[str]) -> frozenset[str]:
    """Return ``config.refresh``; InputError if one is none of a flow's stages."""
    for name in config.refresh:
        if name not in stages:
            raise InputError(
                f"refresh: found {name!r}, expected one of the stages {', '.join(stages)}"
                f"{did_you_mean(name, stages)}"
            )
    return frozenset(config.refresh)


@contextmanager
def writing(out: Path) -> Iterator[None]:
    """Raise InputError where results cannot be written to the output folder within the block."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{out}: cannot write the results ({error.strerror or error}); they are kept in the "
            "store, so make room there, or choose another folder with -o, and run again"
        ) from error


def check_folder(out: Path) -> None:
    """Make the output folder; InputError now, not after the work, if it cannot be written."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_atomic(out / ".probe", b"")
        (out / ".probe").unlink()
    except OSError as error:
        raise InputError(
            f"{out}: cannot write there ({error.strerror}); choose another folder with -o"
        ) from error


def publish_markdown(key: str, markdown: str, description: str = "") -> None:
    """Create a Markdown artifact of a key, lower-case letters, digits and dashes."""
    _publish(lambda: create_markdown_artifact(markdown, key, description or None))


def publish_table(key: str, rows: Sequence[dict[str, Any]]) -> None:
    """Create a table artifact of a key, of the first :data:`MOST_ROWS` rows."""
    _publish(lambda: create_table_artifact(list(rows[:MOST_ROWS]), key))


def _publish(create: Callable[[], Any]) -> None:
    """Create an artifact where the server is the user's: ours ends with the command."""
    if NO_EVENTS in os.environ:
        return
    try:
        create()
    except Exception as error:  # a server that is gone costs the artifact, not the run
        log(logging.WARNING, "artifact_failed", f"an artifact was not created: {error}")
