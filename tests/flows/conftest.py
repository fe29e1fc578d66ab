"""One Prefect server for all flow tests; its address is set before anything imports Prefect."""

import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from flows.runners.environment import prepare
from flows.runners.server import LocalServer


def pytest_configure(config):
    home = Path(tempfile.mkdtemp(prefix="slg-flows-"))
    prepare(home)
    config.slg_server = LocalServer(home)
    os.environ["PREFECT_API_URL"] = config.slg_server.url
    os.environ["SLGAUSSIAN_NO_EVENTS"] = "1"  # as in a run with a server of its own


@pytest.fixture(scope="session")
def server(request):
    """The address of a running Prefect server."""
    server = request.config.slg_server
    server.start()
    server.wait()
    yield server
    server.stop()


@pytest.fixture
def ask(monkeypatch, capsys):
    """The exit status of a command, and each line that it prints, read as JSON."""

    def call(*words):
        from command import run

        capsys.readouterr()
        status = run(monkeypatch, *words, "--json")
        return status, [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    return call


@pytest.fixture
def home() -> Iterator[Path]:
    """Home and temporary folder of a program; the paths of Ray's sockets must be short."""
    with tempfile.TemporaryDirectory(prefix="slg-") as folder:
        yield Path(folder)
