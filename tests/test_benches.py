"""Benches are no part of the suite; what they say of a wrong argument is."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

BENCHES = Path(__file__).parents[1] / "benches"


@pytest.fixture
def pairs(monkeypatch):
    monkeypatch.syspath_prepend(BENCHES)
    monkeypatch.delitem(sys.modules, "pairs", raising=False)
    import pairs

    yield pairs
    del sys.modules["pairs"]


def test_another_folder_than_data_is_one_sentence(pairs, tmp_path):
    with pytest.raises(SystemExit, match=r"DATA: nowhere is no folder; give a folder with trans"):
        pairs.photographs("nowhere")
    (tmp_path / "office").mkdir()
    for name in ("transforms.json", "pairs.json"):
        (tmp_path / "office" / name).write_text("{}")
    with pytest.raises(SystemExit) as left:
        pairs.photographs(str(tmp_path))
    assert left.value.code == (
        f"error: DATA: {tmp_path} holds no transforms.json and no pairs.json; "
        f"did you mean {tmp_path / 'office'}?"
    )
    assert pairs.photographs(str(tmp_path / "office")) == tmp_path / "office"
    with pytest.raises(SystemExit, match=f"did you mean {tmp_path}"):
        pairs.data_folder("office/pairs.json")(str(tmp_path / "office"))


def test_a_bench_ends_so_before_it_works(tmp_path):
    made = subprocess.run(
        [sys.executable, BENCHES / "synonyms.py", "model", tmp_path], capture_output=True, text=True
    )
    assert made.returncode == 1 and made.stderr.startswith("error: DATA: ")
    assert made.stderr.count("\n") == 1


@pytest.mark.parametrize("bench", sorted(BENCHES.glob("*.py")), ids=lambda file: file.stem)
def test_no_bench_takes_any_folder_as_data(bench):
    taken = re.findall(r'add_argument\(\s*"(?:--)?data"[^)]*type=Path', bench.read_text())
    assert taken == []
