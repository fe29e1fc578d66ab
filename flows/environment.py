"""Prefect's environment: offline, quiet, inside the store. Set before prefect is imported.

Each variable can be overridden from outside. ``PREFECT_API_URL`` set from outside means that a
server runs already; then none is started.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from flows.server import LocalServer
from slgaussian.local_cache import user_cache
from slgaussian.store import ArtifactStore


def prepare(home: Path) -> None:
    """Set the environment variables that are not set yet."""
    variables = {
        "PREFECT_HOME": str(home),
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        "DO_NOT_TRACK": "1",
        # Without this, a server that stops prints pages of cancelled database calls.
        "PREFECT_SERVER_LOGGING_LEVEL": "CRITICAL",
        # Progress and failures are told by flows.progress.
        "PREFECT_LOGGING_LEVEL": "CRITICAL",
        "PREFECT_LOGGING_TO_API_ENABLED": "false",
        # Never Prefect's own embedded server: it stays behind when this process is killed.
        "PREFECT_SERVER_EPHEMERAL_ENABLED": "false",
    }
    for name, value in variables.items():
        os.environ.setdefault(name, value)


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
        from prefect.events.clients import NullEventsClient
        from prefect.events.worker import EventsWorker

        # Nobody watches this server, and events cost it 36 kB a task and a second at the end.
        EventsWorker.set_client_override(NullEventsClient)
        yield server.wait
    finally:
        server.stop()
        del os.environ["PREFECT_API_URL"]
