"""Comparison of runs: differences of settings and scores, and ranking of methods."""

import json
from pathlib import Path

import pytest

from slgaussian.benchmark.outputs import write_file, write_samples
from slgaussian.benchmark.reports.comparison import (
    compare_runs,
    differing_settings,
    rank_methods,
    read_run,
)
from slgaussian.benchmark.scores import Rows
from slgaussian.errors import InputError, SpecError

MANIFEST = {
    "settings": {"share": 0.7, "seed": 0},
    "methods": {"query-2d": "query-2d"},
    "data": {"procedural_3": {"sample": "aa", "files": {"a.png": "11"}}},
}


def leave(folder: Path, result, change=lambda row: row, manifest=MANIFEST) -> Path:
    """Write the output folder of a run, with changed rows; a row that becomes None is left out."""
    rows = [change(dict(row)) for row in result.rows]
    write_samples(Rows.from_rows(row for row in rows if row is not None), folder)
    write_file(folder / "manifest.json", json.dumps(manifest).encode())
    return folder


def compare(*folders):
    """Compare runs: counts of each, and the blocks of each section by the start of its title."""
    report, _ = compare_runs([read_run(folder) for folder in folders])
    sections = {section.title.partition(":")[0]: section.blocks for section in report.sections}
    (table,) = sections["Runs"]
    return [[cell.value for cell in row[2:]] for row in table.rows], sections


@pytest.fixture
def first(tmp_path, result):
    return leave(tmp_path / "a", result)


@pytest.fixture
def leading_rows(result):
    return [r for r in result.rows if r["protocol"] == "slgaussian@2" and r["iou"] is not None]


def test_compare_runs_finds_no_difference_of_equal_runs(tmp_path, first, result):
    counts, sections = compare(first, leave(tmp_path / "b", result))
    every = str(len(result.rows))
    assert counts == [["1", "1", every, every, "0"]] * 2
    table, extra = sections["Differences"]
    for gains in (table, *extra.blocks):
        assert {float(cell.value) for row in gains.rows for cell in row[1:]} == {0.0}


def test_compare_runs_counts_a_changed_sample(tmp_path, first, result, leading_rows):
    changed = leading_rows[0]

    def change(row):
        return {**row, "iou": row["iou"] - 0.25} if row == changed else row

    second = leave(tmp_path / "b", result, change)
    counts, sections = compare(first, second)
    assert counts[1][-1] == "1"
    gain = sections["Differences"][0].rows[0][1].value
    assert gain == f"{-0.25 / len(leading_rows):+.3f}"
    _, back = compare(second, first)
    assert back["Differences"][0].rows[0][1].value == gain.replace("-", "+")


def test_differing_settings_lists_leaves_and_scenes():
    other = {
        **MANIFEST,
        "settings": {"share": 0.5, "seed": 0},
        "methods": {"query-2d": "query-2d", "no-bank": "no-bank"},
        "data": {"procedural_3": {"sample": "aa", "files": {"a.png": "22"}}, "new": {}},
    }
    assert differing_settings([MANIFEST, other, MANIFEST]) == [
        ["settings.share", "0.7", "0.5", "0.7"],
        ["methods.no-bank", "–", "no-bank", "–"],
        ["data: missing or different scenes", "new", "procedural_3", "new"],
    ]


def test_compare_runs_ignores_samples_without_a_counterpart(tmp_path, first, result, leading_rows):
    query, every = leading_rows[0]["query"], len(result.rows)
    less = leave(tmp_path / "less", result, lambda row: None if row["query"] == query else row)
    left = str(every - sum(row["query"] == query for row in result.rows))
    assert compare(first, less)[0][1][2:4] == [left, left]
    mine = leave(tmp_path / "mine", result, lambda row: {**row, "method": "mine"})
    assert compare(first, mine)[1]["Differences"][0].rows[0][0].value == "mine − slgaussian"
    for name, change in (("small", {"width": 72}), ("attic", {"dataset": "attic", "scene": "x"})):
        other = leave(tmp_path / name, result, lambda row, c=change: row | c)
        counts, sections = compare(first, other)
        assert counts[1][3] == "0" and "Differences" not in sections


def test_rank_methods_uses_common_samples_of_equal_truth(tmp_path, first, result, leading_rows):
    def rank(*folders):
        return rank_methods(dict(zip("ABC", map(read_run, folders), strict=False)))

    query = leading_rows[0]["query"]
    less = leave(tmp_path / "less", result, lambda row: None if row["query"] == query else row)
    (table, *_) = rank(first, less)
    left = len({row["query"] for row in leading_rows} - {query})
    assert [row[-1].value for row in table.rows] == [str(left)] * 2
    small = leave(tmp_path / "b", result, lambda row: {**row, "width": row["width"] // 2})
    truths = [
        leave(tmp_path / t, result, manifest={**MANIFEST, "data": {result.scene: {"truth": t}}})
        for t in ("aa", "bb")
    ]
    assert rank(first, small) == rank(*truths) == []
    assert len(rank(first, truths[0])) == len(rank(first))


def test_compare_refuses_missing_damaged_and_repeated_runs(tmp_path, first, result):
    with pytest.raises(InputError, match="is given twice"):
        compare(first, leave(tmp_path / "b", result), first)
    with pytest.raises(InputError, match="found 1 run, expected 2 to 26"):
        compare(first)
    with pytest.raises(InputError, match=r"samples\.parquet: cannot be read \(No such file or dir"):
        read_run(tmp_path)
    with pytest.raises(InputError, match=r"samples\.parquet: cannot be read \(.*\), expected"):
        (tmp_path / "samples.parquet").symlink_to("/proc/self/mem")
        read_run(tmp_path)
    (tmp_path / "samples.parquet").unlink()
    (tmp_path / "samples.parquet").write_bytes(b"no table")
    with pytest.raises(SpecError, match=r"samples\.parquet: .* that cannot be read"):
        read_run(tmp_path)
    (first / "manifest.json").write_text("[1]")
    with pytest.raises(InputError, match=r"manifest\.json: found no JSON object"):
        read_run(first)
    (first / "manifest.json").unlink()
    assert read_run(first).manifest == {}
