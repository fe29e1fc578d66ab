"""Groups of :mod:`benches.pipeline.user_commands`; output of ``--help``: ``test_help.py``."""

import sys
from pathlib import Path

import pytest

from benches.pipeline import user_commands

pytestmark = pytest.mark.whole


def check(group: str, folder: Path, **variables: str) -> None:
    """Run a group of commands; check statuses and files."""
    program = [str(Path(sys.executable).parent / "slgaussian")]
    results = user_commands.record_groups(program, folder, None, [group], variables)
    assert user_commands.check(results) == []
    assert len(results) > 2


def test_commands_build_and_query_a_field(tmp_path):
    check("fields", tmp_path)


def test_a_corpus_is_prepared_and_learnt(server, tmp_path):
    check("corpus", tmp_path, PREFECT_API_URL=server.url)


def test_a_killed_run_leaves_the_files_of_an_undisturbed_one(tmp_path):
    """Each command starts its own server."""
    check("killed", tmp_path)
