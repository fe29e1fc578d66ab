"""Text files are read with and without a byte-order mark."""

import codecs
import json

import pytest

from flows.config import CorpusSettings
from flows.read_config import read_values
from slgaussian.benchmark.annotations import labelled_frames
from slgaussian.formats import strict_json
from slgaussian.io import read_lines

NAMES = ["a  b", "a b", "c\u2028d", "e\x85f", "g\x0bh", "i\x0cj", "k\x1cl"]


@pytest.mark.parametrize("mark", [b"", codecs.BOM_UTF8])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_read_lines_splits_only_at_line_breaks(tmp_path, mark, end):
    file = tmp_path / "classes.txt"
    file.write_bytes(mark + end.join([*NAMES, ""]).encode())
    assert read_lines(file) == [*NAMES, ""]
    (tmp_path / "0").mkdir()
    assert labelled_frames(tmp_path) == {"0": tuple(sorted(NAMES))}
    assert CorpusSettings(
        sources=["chunks"], out=tmp_path, withdrawn=file
    ).withdrawn_clips() == set(NAMES)
    (tmp_path / "run.toml").write_bytes(mark + f'out = "x"{end}'.encode())
    assert read_values(tmp_path / "run.toml", {})["out"] == str(tmp_path / "x")
    assert strict_json.parse(mark + json.dumps(NAMES).encode()) == NAMES
