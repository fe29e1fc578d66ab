"""The short form of :mod:`benches.pipeline.user_commands`: runs by every runner, and killed ones.

A file apart from the other commands, so that two processes share them.
"""

import pytest
from test_user_commands import check

pytestmark = pytest.mark.whole


def test_every_runner_leaves_the_same_files(server, tmp_path):
    check("runners", tmp_path, PREFECT_API_URL=server.url)


def test_a_killed_run_leaves_the_files_of_an_undisturbed_one(tmp_path):
    """Each command has a server of its own."""
    check("killed", tmp_path)
