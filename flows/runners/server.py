"""A local Prefect API server that cannot outlive the program that started it.

Prefect's embedded server is a child process that survives when its parent is killed. This one holds
the reading end of a pipe whose writing end only the parent has: when the parent dies, even by
``kill -9``, the kernel closes the pipe and the server exits.
"""

from __future__ import annotations

import hashlib
import os
import socket
import sqlite3
import subprocess
import sys
import tempfile
import threading
import urllib.error
import urllib.request
from contextlib import closing, suppress
from importlib.metadata import version
from pathlib import Path

from slgaussian.errors import InputError, SLGaussianError
from slgaussian.storage.local_copies import LocalCache
from slgaussian.system import HANDS_OVER_SOCKETS

LOOPBACK = "127.0.0.1"

START_TIMEOUT = 120.0
"""Seconds to wait for the server; its first start on a machine also creates a database."""

DATABASE = "prefect.db"


class LocalServer:
    """A server on a free port of this machine, its database in folder ``home``.

    The port is bound on construction, so that :attr:`url` can be set in the environment before
    Prefect is imported. :meth:`start` returns before the server is ready; :meth:`wait` waits.
    """

    def __init__(self, home: Path) -> None:
        self.home = home
        self.log = home / "server.log"
        self.socket = socket.create_server((LOOPBACK, 0), backlog=128)
        self.url = f"http://{LOOPBACK}:{self.socket.getsockname()[1]}/api"
        self.process: subprocess.Popen | None = None
        self.makes_database = False

    def start(self) -> None:
        """Start the server process; InputError if its folder cannot be written, or on Windows."""
        if not HANDS_OVER_SOCKETS:
            raise InputError(
                "on Windows this command needs a server that runs already: start `prefect server "
                "start`, and set PREFECT_API_URL to its address"
            )
        inherited = self.socket.fileno()
        try:
            self.home.mkdir(parents=True, exist_ok=True)
            self.makes_database = not _lay_database(self.home)
            # A file of its own: an inherited pipe would keep readers of our output waiting.
            log = self.log.open("wb")
        except OSError as error:
            raise InputError(
                f"{self.home}: cannot store the history of runs ({error.strerror}); choose a "
                "writable folder with --store"
            ) from error
        with log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "flows.runners.server", str(inherited)],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                pass_fds=[inherited],
                start_new_session=True,  # on Ctrl-C the run stops the server itself
                env={
                    **os.environ,
                    "PYTHONPATH": import_path(),
                    "PYTHONSAFEPATH": "1",
                    "PREFECT_HOME": str(self.home),
                    "PREFECT_UI_ENABLED": "0",
                    "PREFECT__SERVER_EPHEMERAL": "1",
                    "PREFECT__SERVER_FINAL": "1",
                },
            )
        self.socket.close()

    def wait(self) -> None:
        """Wait until the server answers; SLGaussianError naming its log if it does not."""
        try:
            # The socket listens already, so this request waits for the application.
            urllib.request.urlopen(f"{self.url}/health", timeout=START_TIMEOUT).close()
        except (OSError, urllib.error.URLError) as error:
            self.stop()
            raise SLGaussianError(
                f"the Prefect server did not start ({error}); its output is in {self.log}; make "
                f"sure that the disk has room, or, if its database is damaged, delete {self.home}, "
                "which holds only the history of runs"
            ) from error
        if self.makes_database:
            _keep_database(self.home)

    def stop(self) -> None:
        """Close the pipe and wait until the server exits."""
        if self.process is not None and self.process.stdin is not None:
            self.process.stdin.close()
            self.process.wait(timeout=10)
            self.process = None


def import_path() -> str:
    """Return the import path of this Python, for ``PYTHONPATH`` of another one."""
    root, places = str(Path(__file__).resolve().parents[2]), [*filter(None, sys.path)]
    return os.pathsep.join(places if root in places else [root, *places])  # '' may stand for it


def _lay_database(home: Path) -> bool:
    """Copy an empty database from the user's cache unless ``home`` has one; return if it has one.

    Prefect creates a database by hundreds of migrations, which take longer than the server's start.
    """
    place, cache = home / DATABASE, LocalCache.from_environment()
    if not place.exists() and cache is not None and (cached := cache.get(_database_cache())):
        digest, data = cached[:32], cached[32:]
        if hashlib.sha256(data).digest() != digest:
            return False
        with suppress(OSError), tempfile.NamedTemporaryFile(dir=home, prefix=".database-") as file:
            file.write(data)
            file.flush()
            os.link(file.name, place)  # does not replace the file of another server
    return place.exists()


def _keep_database(home: Path) -> None:
    """Copy the new database in ``home`` to the user's cache, for later servers."""
    cache, place = LocalCache.from_environment(), home / DATABASE
    if cache is None or not place.exists():  # Prefect's database is configured elsewhere
        return
    with (
        suppress(sqlite3.Error, AttributeError),  # some builds of SQLite do not serialise
        closing(sqlite3.connect(place)) as live,
        closing(sqlite3.connect(":memory:")) as copy,
    ):
        live.backup(copy)
        data = copy.serialize()
        cache.put(_database_cache(), hashlib.sha256(data).digest() + data)


def _database_cache() -> str:
    return f"prefect/{version('prefect')}.db"


def serve(inherited: int) -> None:
    """Serve on the inherited socket until standard input ends, as the server process."""
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    import uvicorn
    from prefect.server.api.server import create_app

    config = uvicorn.Config(create_app, factory=True, log_level="error", lifespan="on")
    uvicorn.Server(config).run(sockets=[socket.socket(fileno=inherited)])


def _exit_with_parent() -> None:
    sys.stdin.buffer.read()
    # Immediately: the database holds only history, and SQLite's log survives this.
    os._exit(0)


if __name__ == "__main__":
    serve(int(sys.argv[1]))
