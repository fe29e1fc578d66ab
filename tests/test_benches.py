"""Arguments of benches, and the blocks that they write into pages."""

import importlib
import re
from pathlib import Path

import pytest

from benches.common import harness

ROOT = Path(__file__).parents[1]
BENCHES = sorted((ROOT / "benches").rglob("*.py"))


def module(bench):
    return ".".join(bench.relative_to(ROOT).with_suffix("").parts)


@pytest.mark.parametrize("bench", BENCHES, ids=lambda file: file.stem)
def test_bench_imports_without_error(bench):
    importlib.import_module(module(bench))


def test_publish_replaces_only_its_block_of_a_page(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(harness, "describe_measurement", lambda: "Measured today.")
    page = tmp_path / "words.md"
    page.write_text("# Words\n\n<!-- a -->\nold\n<!-- end of a -->\n\nWritten by hand.\n")
    rows = [{"name": "one", "seconds": 0.01234, "off": 0.00123}, {"name": "two"}]
    columns = {"name": ("name", str), "seconds": ("ms", harness.ms), "off": ("off", harness.error)}
    written = harness.table(rows, columns)
    assert written.splitlines()[1:] == [
        "| --- | --: | --: |",
        "| one | 12.3 | 1.2e-3 |",
        "| two |  |  |",
    ]
    for name in "ab":
        harness.publish(tmp_path, "words.md", f"python -m benches.x.{name} DATA", written)
    block = "<!-- {0} -->\n\nMeasured today, by `python -m benches.x.{0} DATA`.\n\n{1}\n\n"
    block += "<!-- end of {0} -->"
    a, b = (block.format(name, written) for name in "ab")
    assert page.read_text() == f"# Words\n\n{a}\n\nWritten by hand.\n\n{b}\n"
    assert capsys.readouterr().out == f"{a}\n{b}\n"


@pytest.mark.parametrize(
    "page", sorted((ROOT / "docs/measured").glob("*.md")), ids=lambda page: page.stem
)
def test_page_blocks_name_benches_that_write_them(page):
    blocks = re.findall(r"<!-- (\w+) -->.*?`python -m ([\w.]+)", page.read_text(), re.DOTALL)
    for name, bench in blocks:
        assert bench.rpartition(".")[2] == name
        source = (ROOT / (bench.replace(".", "/") + ".py")).read_text()
        assert page.name in source
