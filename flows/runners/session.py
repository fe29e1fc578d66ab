"""Common frame of flows: provenance, damaged artifacts, final state, Prefect artifacts."""

from __future__ import annotations

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

from flows.runners import logger
from flows.runners.batches import Failure
from flows.runners.task_runners import NO_EVENTS
from slgaussian.errors import InputError, did_you_mean
from slgaussian.io import write_atomic
from slgaussian.storage.provenance import Provenance, record_provenance
from slgaussian.storage.store import ArtifactStore, DamagedError

Result = TypeVar("Result")

RESULTS: list[Any] = []
"""Result of the last flow of this process, even if the server has not received it."""

MAX_NAMED = 50
"""Largest number of scenes in the message of a state."""

MAX_ROWS = 500
"""Largest number of rows of a table artifact, which Prefect shows on one page."""


def run_session(command: str, config: Any, work: Callable[[ArtifactStore], Result]) -> Result:
    """Do the work of a flow with its store, and repair damaged artifacts.

    An artifact that is found damaged is removed, and the work is repeated: that recomputes the
    artifact and finds the others in the store.

    Args:
        command: Name of the command, for provenance.
        config: The flow's configuration, with ``store`` and ``out`` at least.

    Raises:
        SLGaussianError: As ``work``, and if a damaged artifact is not recomputed by it.
    """
    store = ArtifactStore(config.store)
    if deployment.id is not None:
        threading.Thread(target=_exit_with_parent, args=(os.getppid(),), daemon=True).start()
    damaged: dict[str, str] = {}
    check_folder(config.out)
    with record_provenance(Provenance(command)):
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
                logger.warning(message)
                print(message, file=sys.stderr, flush=True)


def _exit_with_parent(parent: int) -> None:
    """End this process when the process that serves its deployment is gone."""
    while os.getppid() == parent:
        time.sleep(1)
    os._exit(1)


def completed(
    message: str, result: Result, failures: Sequence[Failure] = (), name: str = "Completed"
) -> State[Result]:
    """Return the final state of a flow, whose message names scenes that were left out."""
    names = list(dict.fromkeys(failure.scene for failure in failures))
    if names:
        rest = f" and {len(names) - MAX_NAMED} more" if names[MAX_NAMED:] else ""
        message += f"; left out: {', '.join(names[:MAX_NAMED])}{rest}"
    RESULTS[:] = [result]
    return Completed(name=name, message=message, data=result)


def stages_to_refresh(config: Any, stages: Sequence[str]) -> frozenset[str]:
    """Return ``config.refresh``; InputError if an element is no stage of the flow."""
    for name in config.refresh:
        if name not in stages:
            raise InputError(
                f"refresh: found {name!r}, expected one of the stages {', '.join(stages)}"
                f"{did_you_mean(name, stages)}"
            )
    return frozenset(config.refresh)


@contextmanager
def writing(out: Path) -> Iterator[None]:
    """Convert OSError within the block, which writes results, to InputError."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{out}: cannot write the results ({error.strerror or error}); they are kept in the "
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


def publish(key: str, content: str | Sequence[dict[str, Any]]) -> None:
    """Create a Prefect artifact on an external server; our own ends with the command.

    Args:
        key: Lower-case letters, digits and dashes.
        content: Markdown, or a table, of which the first :data:`MAX_ROWS` rows are used.
    """
    if NO_EVENTS in os.environ:
        return
    try:
        if isinstance(content, str):
            create_markdown_artifact(content, key)
        else:
            create_table_artifact(list(content[:MAX_ROWS]), key)
    except Exception as error:  # the run continues without its artifact
        logger.warning("an artifact was not created: %s", error)
