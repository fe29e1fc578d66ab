"""A Prefect API server of our own that cannot outlive the program that started it.

Prefect's embedded server is a child process that stays behind when its parent is killed. This one
holds the reading end of a pipe whose writing end only the parent has: however the parent dies,
``kill -9`` included, the kernel closes the pipe and the server leaves.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from pathlib import Path

from flows.runners import child
from slgaussian.errors import InputError, SLGaussianError

LOOPBACK = "127.0.0.1"

START_TIMEOUT = 120.0
"""Seconds to wait for the server; its first start in a store also makes the database."""


class LocalServer:
    """A server on a free port of this machine, its database in folder ``home``.

    The port is bound at once, so that :attr:`url` can be put into the environment before Prefect
    is imported; :meth:`start` returns while the server is still coming up, and :meth:`wait` waits.
    """

    def __init__(self, home: Path) -> None:
        self.home = home
        self.log = home / "server.log"
        self.socket = socket.create_server((LOOPBACK, 0), backlog=128)
        self.url = f"http://{LOOPBACK}:{self.socket.getsockname()[1]}/api"
        self.process: subprocess.Popen | None = None

    def start(self) -> None:
        """Start the server process; InputError if its folder cannot be written."""
        inherited = self.socket.fileno()
        try:
            self.home.mkdir(parents=True, exist_ok=True)
            # Its own output file: a pipe of ours that it inherited would keep our readers waiting.
            log = self.log.open("wb")
        except OSError as error:
            raise InputError(
                f"{self.home}: cannot keep the records of runs there ({error.strerror}); choose a "
                "writable folder with --store"
            ) from error
        with log:
            self.process = child.begin(
                "flows.runners.server",
                str(inherited),
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                pass_fds=[inherited],
                start_new_session=True,  # Ctrl-C is for the run, which then stops the server
                env={
                    "PREFECT_HOME": str(self.home),
                    "PREFECT_UI_ENABLED": "0",
                    "PREFECT__SERVER_EPHEMERAL": "1",
                    "PREFECT__SERVER_FINAL": "1",
                },
            )
        self.socket.close()

    def wait(self) -> None:
        """Return when the server answers; SLGaussianError with its log's place if it does not."""
        try:
            # The socket listens already, so this request simply waits for the application.
            urllib.request.urlopen(f"{self.url}/health", timeout=START_TIMEOUT).close()
        except (OSError, urllib.error.URLError) as error:
            self.stop()
            raise SLGaussianError(
                f"the Prefect server did not start ({error}); its output is in {self.log}; make "
                f"sure that the disk has room, or, if its database is damaged, delete {self.home}, "
                "which holds only the history of runs"
            ) from error

    def stop(self) -> None:
        """Close the pipe and wait for the server to leave."""
        if self.process is not None:
            if self.process.stdin is not None:
                self.process.stdin.close()
            self.process.wait(timeout=10)
            self.process = None


def serve(inherited: int) -> None:
    """The server process: serve on the inherited socket until standard input ends."""
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    import uvicorn
    from prefect.server.api.server import create_app

    config = uvicorn.Config(create_app, factory=True, log_level="error", lifespan="on")
    uvicorn.Server(config).run(sockets=[socket.socket(fileno=inherited)])


def _leave_with_parent() -> None:
    sys.stdin.buffer.read()
    # At once: what the database holds is history only, and SQLite's log survives this.
    os._exit(0)


if __name__ == "__main__":
    serve(int(sys.argv[1]))
