"""Prefect's environment of commands: offline, quiet, with its home in the store.

Variables are set before Prefect is imported, unless they are set already. If ``PREFECT_API_URL`` is
set, its server is used and none is started.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from httpx import HTTPError

from flows.runners import logger
from flows.runners.server import LocalServer
from slgaussian.errors import SLGaussianError
from slgaussian.storage.local_copies import user_cache
from slgaussian.storage.remote import redact
from slgaussian.storage.store import ArtifactStore

if TYPE_CHECKING:  # Prefect must be imported after its environment is set
    from prefect import Flow

FLOWS = {
    "demo": "flows.benchmark:score_scenes",
    "benchmark": "flows.benchmark:score_scenes",
    "run": "flows.benchmark:score_scenes",
    "ingest": "flows.corpus:ingest_corpus",
    "supervise": "flows.corpus:supervise_corpus",
    "dataset": "flows.dataset:make_training_set",
    "train": "flows.training:train_branch",
    "retrain": "flows.retraining:retrain",
}
"""Prefect flow of each command, called with its configuration and ``verbose``."""


def prepare(home: Path) -> None:
    """Set the environment variables that are not set yet."""
    variables = {
        "PREFECT_HOME": str(home),
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        "DO_NOT_TRACK": "1",
        # Suppresses pages of cancelled database calls when the server stops.
        "PREFECT_SERVER_LOGGING_LEVEL": "CRITICAL",
        # flows.runners.progress reports progress and failures.
        "PREFECT_LOGGING_LEVEL": "CRITICAL",
        # Also if the user has set that level for Prefect's page.
        "PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "CRITICAL",
        # Our own server ends with the run, so its logs cannot be read.
        "PREFECT_LOGGING_TO_API_ENABLED": str(bool(os.environ.get("PREFECT_API_URL"))),
        "PREFECT_LOGGING_EXTRA_LOGGERS": "slgaussian",
        "PREFECT_LOGGING_TO_API_WHEN_MISSING_FLOW": "ignore",
        # Prefect's embedded server would survive when this process is killed.
        "PREFECT_SERVER_EPHEMERAL_ENABLED": "false",
    }
    for name, value in variables.items():
        os.environ.setdefault(name, value)


def find_prefect_home(store: ArtifactStore) -> Path:
    """Return the folder of Prefect's database: in a local store, else in the user's cache."""
    if store.local:
        return Path(store.path) / ".prefect"
    return user_cache() / "prefect"


@contextmanager
def orchestration(store: ArtifactStore) -> Iterator[Callable[[], None]]:
    """Provide a Prefect server within the block, an external one or our own.

    Our server starts while the block imports its modules. The yielded function waits until the
    server answers, and raises SLGaussianError if it does not.
    """
    prepare(find_prefect_home(store))
    if os.environ.get("PREFECT_API_URL"):
        yield lambda: None
        return
    server = LocalServer(Path(os.environ["PREFECT_HOME"]))
    os.environ["PREFECT_API_URL"] = server.url
    try:
        server.start()
        from prefect.settings import PREFECT_FLOWS_HEARTBEAT_FREQUENCY, temporary_settings

        from flows.runners.task_runners import NO_EVENTS, send_events

        # Our own server has no viewers.
        send_events(False)
        outside = os.environ.setdefault(NO_EVENTS, "here")
        # Heartbeats would delay the end by up to a second.
        with temporary_settings({PREFECT_FLOWS_HEARTBEAT_FREQUENCY: None}):
            yield server.wait
        if outside == "here":
            del os.environ[NO_EVENTS]
    finally:
        server.stop()
        del os.environ["PREFECT_API_URL"]


@contextmanager
def interruptible() -> Iterator[None]:
    """Clean up and end the program immediately on Ctrl-C or SIGTERM within the block.

    Context managers of the block exit as after any error. Then the program ends by the signal
    itself, without waiting for threads that still compute a stage.
    """

    received = signal.SIGINT

    def terminate(number: int, frame: object) -> NoReturn:
        nonlocal received
        received = signal.SIGTERM
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    except KeyboardInterrupt:
        sys.stderr.write("\nstopped; the same command goes on from here\n")
        sys.stderr.flush()
        signal.signal(received, signal.SIG_DFL)
        atexit._run_exitfuncs()  # avoids warnings of leaked process pools
        signal.raise_signal(received)
    finally:
        signal.signal(signal.SIGTERM, before)


def call_flow(flow: Flow[..., Any], *arguments: Any) -> Any:
    """Call a flow that ends in :func:`flows.runners.session.final`; return its result.

    Also if that state is Failed. If the server fails after the work is done, e.g. because its disk
    is full, only the final state is lost.

    Raises:
        SLGaussianError: As the flow, and if the server fails before the work is done.
    """
    from flows.runners.session import RESULTS

    RESULTS.clear()
    try:
        state: Any = flow(*arguments, return_state=True)
        return RESULTS[0] if RESULTS else state.result()
    except HTTPError as error:
        url, home = redact(os.environ["PREFECT_API_URL"]), os.environ["PREFECT_HOME"]
        failed = f"the Prefect server at {url} failed ({error})"
        if RESULTS:
            message = f"{failed} after the work; it may show this run as running forever"
            logger.warning(message)
            print(message, file=sys.stderr)
            return RESULTS[0]
        raise SLGaussianError(
            f"{failed}; start it, or unset PREFECT_API_URL to use a local server, which may need "
            f"space on the disk of {home}; finished stages are in the store, and the same command "
            "continues"
        ) from error
