"""A small part of ``benches/pipeline/fuzz_readers.py``; the table is ``docs/measured/fuzz.md``."""

import pytest

from tests.small_files import FORMATS, verdict

SEED, COUNT = 1, 12


@pytest.mark.parametrize("name", FORMATS)
def test_damaged_file_is_read_or_refused_by_name(name, tmp_path, recwarn):
    folder = tmp_path / "set"
    folder.mkdir()
    FORMATS[name].make(folder)
    FORMATS[name].read(folder)
    verdicts = [verdict(name, number, SEED, folder) for number in range(COUNT)]
    assert [message for kind, message in verdicts if kind not in ("accepted", "refused")] == []
    assert "refused" in {kind for kind, _ in verdicts}
    FORMATS[name].read(folder)  # whole again
