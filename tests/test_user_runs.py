"""The short form of :mod:`benches.pipeline.user_commands`: runs by every runner, and killed ones.

A file apart from the other commands, so that two processes share them.
"""

import pytest
from test_user_commands import test_every_command_ends_as_it_should as ends_as_it_should

pytestmark = pytest.mark.whole


@pytest.mark.parametrize("group", ["runners", "killed"])
def test_every_run_leaves_the_same_files(group, tmp_path):
    ends_as_it_should(group, tmp_path)
