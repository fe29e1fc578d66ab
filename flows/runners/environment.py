"""Flows as commands start them, in Prefect's environment: offline, quiet, inside the store.

It is set before Prefect is imported. Each variable can be overridden from outside;
``PREFECT_API_URL`` set from outside means that a server runs already; then none is started.
"""

from __future__ import annotations

import atexit
import logging
import os
import secrets
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from httpx import HTTPError

from flows.runners.log_file import log
from flows.runners.server import LocalServer
from slgaussian.errors import SLGaussianError
from slgaussian.storage.local_copies import user_cache
from slgaussian.storage.remote import redacted
from slgaussian.storage.store import ArtifactStore

if TYPE_CHECKING:  # Prefect is imported once its environment is set
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
"""The Prefect flow of each command, called with its configuration and whether to be verbose."""


def prepare(home: Path) -> None:
    """Set the environment variables that are not set yet."""
    variables = {
        "PREFECT_HOME": str(home),
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        "DO_NOT_TRACK": "1",
        # Without this, a server that stops prints pages of cancelled database calls.
        "PREFECT_SERVER_LOGGING_LEVEL": "CRITICAL",
        # Progress and failures are told by flows.runners.progress.
        "PREFECT_LOGGING_LEVEL": "CRITICAL",
        # A server of ours ends with the run: nobody reads there what is logged.
        "PREFECT_LOGGING_TO_API_ENABLED": str(bool(os.environ.get("PREFECT_API_URL"))),
        "PREFECT_LOGGING_EXTRA_LOGGERS": "slgaussian",
        "PREFECT_LOGGING_TO_API_WHEN_MISSING_FLOW": "ignore",
        # Never Prefect's own embedded server: it stays behind when this process is killed.
        "PREFECT_SERVER_EPHEMERAL_ENABLED": "false",
    }
    for name, value in (variables | ray_variables()).items():
        os.environ.setdefault(name, value)


def ray_variables() -> dict[str, str]:
    """Return what Ray must know before it is imported, if it is the runner."""
    variables = {
        "RAY_USAGE_STATS_ENABLED": "0",
        # It would say so whenever a process begins another.
        "GRPC_VERBOSITY": "ERROR",
        # It hides all GPUs from tasks that do not book one.
        "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
        # Who reaches it can have it run code. Left alone, it keeps a token for all to read.
        "RAY_AUTH_MODE": "token",
    }
    if "RAY_AUTH_TOKEN_PATH" in os.environ or Path("~/.ray/auth_token").expanduser().exists():
        return variables
    return variables | {"RAY_AUTH_TOKEN": secrets.token_hex(32)}


def home_of(store: ArtifactStore) -> Path:
    """Where Prefect keeps its database: in a local store, else in the user's cache folder."""
    if store.local:
        return Path(store.path) / ".prefect"
    return user_cache() / "prefect"


@contextmanager
def orchestration(store: ArtifactStore) -> Iterator[Callable[[], None]]:
    """Prefect ready to run flows: a server of ours for the time of the block, or one from outside.

    The server comes up while the block goes on to import what it needs; the function that the
    block is given returns once the server answers and raises SLGaussianError if it never does.
    """
    prepare(home_of(store))
    if os.environ.get("PREFECT_API_URL"):
        yield lambda: None
        return
    server = LocalServer(Path(os.environ["PREFECT_HOME"]))
    os.environ["PREFECT_API_URL"] = server.url
    try:
        server.start()
        from prefect.settings import PREFECT_FLOWS_HEARTBEAT_FREQUENCY, temporary_settings

        from flows.runners.task_runners import NO_EVENTS, send_events

        # Nobody watches this server.
        send_events(False)
        outside = os.environ.setdefault(NO_EVENTS, "here")
        # Heartbeats, which nobody would hear either, delay the end by up to a second.
        with temporary_settings({PREFECT_FLOWS_HEARTBEAT_FREQUENCY: None}):
            yield server.wait
        if outside == "here":
            del os.environ[NO_EVENTS]
    finally:
        server.stop()
        del os.environ["PREFECT_API_URL"]


@contextmanager
def interruptible() -> Iterator[None]:
    """End this program in good order on Ctrl-C or SIGTERM within the block, and at once.

    What was begun in the block is left as after any error; then the program ends as the signal
    itself ends one, without waiting for threads that are at a stage still.
    """

    def terminate(number: int, frame: object) -> NoReturn:
        raise _Terminated

    before = signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    except (KeyboardInterrupt, _Terminated) as reason:
        sys.stderr.write("\nstopped; the same command goes on from here\n")
        sys.stderr.flush()
        number = signal.SIGTERM if isinstance(reason, _Terminated) else signal.SIGINT
        signal.signal(number, signal.SIG_DFL)
        atexit._run_exitfuncs()  # pools of processes would otherwise be said to leak
        os.kill(os.getpid(), number)
    finally:
        signal.signal(signal.SIGTERM, before)


class _Terminated(BaseException):
    """SIGTERM came."""


def perform(command: str, config: Any, verbose: bool = False) -> Any:
    """Run the flow of a command; returns what it returns.

    Raises
    ------
    SLGaussianError
        As the flow, and if the Prefect server fails.
    """
    store = ArtifactStore(config.store)
    with orchestration(store) as wait_for_server:
        # Its imports take as long as the server needs to come up.
        place, name = FLOWS[command].split(":")
        module = import_module(place)
        if hasattr(module, "check"):
            module.check(config, store)
        wait_for_server()
        return call_flow(getattr(module, name), config, verbose)


def call_flow(flow: Flow[..., Any], *arguments: Any) -> Any:
    """Call a flow that ends in :func:`flows.runners.session.completed`; return its result.

    A server that fails during the work, as when it is killed or its disk is full, costs no more
    than that it does not learn the end.

    Raises
    ------
    SLGaussianError
        As the flow, and if the server fails before the work is done.
    """
    from flows.runners.session import RESULTS

    RESULTS.clear()
    try:
        return flow(*arguments)
    except HTTPError as error:
        url, home = redacted(os.environ["PREFECT_API_URL"]), os.environ["PREFECT_HOME"]
        failed = f"the Prefect server at {url} failed ({error})"
        if RESULTS:
            message = f"{failed} when all was done; it may show this run as running for ever"
            log(logging.WARNING, "server_failed", message)
            return RESULTS[0]
        raise SLGaussianError(
            f"{failed}; start it, or unset PREFECT_API_URL, as none of yours is needed; one of our "
            f"own may need room on the disk of {home}; what was made is in the store, and the same "
            "command goes on"
        ) from error
