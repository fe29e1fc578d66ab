"""The short form of :mod:`benches.pipeline.user_commands`: everything that users run, small."""

import sys
from pathlib import Path

import pytest

from benches.pipeline import user_commands

pytestmark = pytest.mark.whole


@pytest.mark.parametrize("group", ["help", "fields", "corpus"])
def test_every_command_ends_as_it_should(group, tmp_path):
    program = [str(Path(sys.executable).parent / "slgaussian")]
    results = user_commands.recorded(program, tmp_path, None, [group])
    assert user_commands.check(results) == []
    assert len(results) > 3
