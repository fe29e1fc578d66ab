"""Commands by their answers, a field to ask, and short paths for what programs store."""

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from command import run, said, two_walls


@pytest.fixture
def slg(monkeypatch, capsys):
    """The exit status of a command, its output, and its errors."""

    def call(*words):
        capsys.readouterr()
        return run(monkeypatch, *words), *capsys.readouterr()

    return call


@pytest.fixture
def ask(slg):
    """The exit status of a command, and each line that it prints, read as JSON."""

    def call(*words):
        status, out, _ = slg(*words, "--json")
        return status, [json.loads(line) for line in out.splitlines()]

    return call


@pytest.fixture
def refusal(monkeypatch, capsys):
    """The one sentence with which a command ends in status 2."""

    def call(*words):
        capsys.readouterr()
        assert run(monkeypatch, *words) == 2
        return said(capsys)

    return call


@pytest.fixture(scope="session")
def walls(tmp_path_factory) -> Path:
    """The field :func:`command.two_walls`, to be read only."""
    return two_walls(tmp_path_factory.mktemp("walls") / "field")


@pytest.fixture
def home() -> Iterator[Path]:
    """Home and temporary folder of a program; the paths of Ray's sockets must be short."""
    with tempfile.TemporaryDirectory(prefix="slg-") as folder:
        yield Path(folder)
