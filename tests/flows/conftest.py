"""Fixtures that run commands, a field to query, and short paths for homes of programs."""

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from command import read_error, run, two_walls

from slgaussian.storage.store import ArtifactStore


@pytest.fixture
def slg(monkeypatch, capsys):
    """Run a command; return exit status, output and errors."""

    def call(*words):
        capsys.readouterr()
        return run(monkeypatch, *words), *capsys.readouterr()

    return call


@pytest.fixture
def ask(slg):
    """Run a command; return exit status and each printed line, parsed as JSON."""

    def call(*words):
        status, out, _ = slg(*words, "--json")
        return status, [json.loads(line) for line in out.splitlines()]

    return call


@pytest.fixture
def refusal(monkeypatch, capsys):
    """Run a command that ends with status 2; return its error message."""

    def call(*words):
        capsys.readouterr()
        assert run(monkeypatch, *words) == 2
        return read_error(capsys)

    return call


@pytest.fixture
def store(tmp_path) -> ArtifactStore:
    return ArtifactStore(tmp_path / "store")


@pytest.fixture(scope="session")
def walls(tmp_path_factory) -> Path:
    """The field :func:`command.two_walls`, to be read only."""
    return two_walls(tmp_path_factory.mktemp("walls") / "field")


@pytest.fixture
def home() -> Iterator[Path]:
    """Home and temporary folder of a program; the paths of Ray's sockets must be short."""
    with tempfile.TemporaryDirectory(prefix="slg-") as folder:
        yield Path(folder)
