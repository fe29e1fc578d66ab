"""Commands whose answers are JSON, and short paths for what programs keep."""

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest


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
    """Home and temporary folder of a program."""
    with tempfile.TemporaryDirectory(prefix="slg-") as folder:
        yield Path(folder)
