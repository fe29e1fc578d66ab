"""Comparison of runs: differences of settings, scores and costs, and ranking of methods."""

import json
from pathlib import Path

import pytest

from slgaussian.benchmark.outputs import (
    write_costs,
    write_file,
    write_predictions,
    write_samples,
)
from slgaussian.benchmark.pictures import encode_png
from slgaussian.benchmark.reports.comparison import (
    compare_runs,
    differing_settings,
    rank_methods,
    read_run,
)
from slgaussian.errors import InputError, SpecError
from slgaussian.storage.specs import load_spec

MANIFEST = {
    "settings": {"share": 0.7, "seed": 0},
    "methods": {"query-2d": "query-2d"},
    "data": {"procedural_3": {"sample": "aa", "files": {"a.png": "11"}}},
}


def leave(folder: Path, result, change=lambda row: row, manifest=MANIFEST) -> Path:
    """Write the output folder of a run, with changed rows."""
    rows = [change(dict(row)) for row in result.rows]
    rows = [row for row in rows if row is not None]
    write_samples(rows, folder)
    masks = {key: encode_png(mask) for key, mask in result.predictions.items()}
    write_predictions(rows, masks, folder / "predictions")
    write_file(folder / "manifest.json", json.dumps(manifest).encode())
    return folder


def compared(*folders):
    return compare_runs([read_run(folder) for folder in folders])


def counts_of(report) -> list[list[str]]:
    """Return the counts of each run: scenes, methods, samples, common with A, changed."""
    (table,) = section(report, "Runs")
    return [[cell.value for cell in row[2:]] for row in table.rows]


def section(report, title: str):
    """Return the blocks of the section with this start of its title; empty if there is none."""
    return next((own.blocks for own in report.sections if own.title.startswith(title)), [])


def scored(result) -> list[dict]:
    return [r for r in result.rows if r["protocol"] == "slgaussian@2" and r["iou"] is not None]


def test_a_run_and_itself_differ_in_nothing(tmp_path, result):
    report = compared(leave(tmp_path / "a", result), leave(tmp_path / "b", result))
    every = str(len(result.rows))
    assert counts_of(report) == [["1", "1", every, every, "0"]] * 2
    assert not section(report, "Costs")
    (table, more) = section(report, "Differences")
    for gains in (table, *more.blocks):
        assert {float(cell.value) for row in gains.rows for cell in row[1:]} == {0.0}


def test_a_change_is_named(tmp_path, result):
    lowered = scored(result)[0]["query"]

    def change(row):
        if row["query"] == lowered and row["protocol"] == "slgaussian@2" and row["iou"] is not None:
            row["iou"] -= 0.25
        return row

    first, second = leave(tmp_path / "a", result), leave(tmp_path / "b", result, change)
    report = compared(first, second)
    assert counts_of(report)[1][-1] == "1"
    gain = section(report, "Differences")[0].rows[0][1].value
    assert gain == f"{-0.25 / len(scored(result)):+.3f}"
    back = compared(second, first)
    assert section(back, "Differences")[0].rows[0][1].value == gain.replace("-", "+")


def test_settings_and_data_are_compared_by_their_leaves():
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


def test_only_queries_of_both_judged_at_one_size_are_compared(tmp_path, result):
    first = leave(tmp_path / "a", result)
    left_out = scored(result)[0]["query"]
    less = leave(tmp_path / "b", result, lambda row: None if row["query"] == left_out else row)
    gone = sum(row["query"] == left_out for row in result.rows)
    every = len(result.rows)
    assert counts_of(compared(first, less))[1][2:4] == [str(every - gone)] * 2
    mine = leave(tmp_path / "c", result, lambda row: {**row, "method": "mine"})
    report = compared(first, mine)
    assert section(report, "Differences")[0].rows[0][0].value == "mine − slgaussian"
    attic = {"dataset": "attic", "scene": "x"}
    for name, change in (("small", {"width": 72}), ("attic", attic)):
        report = compared(first, leave(tmp_path / name, result, lambda row, c=change: row | c))
        assert counts_of(report)[1][3] == "0" and not section(report, "Differences")


def test_costs_of_both_stand_side_by_side(tmp_path, result):
    folders = leave(tmp_path / "a", result), leave(tmp_path / "b", result)
    for folder, seconds in zip(folders, (0.5, 0.25), strict=True):
        named = dict.fromkeys(load_spec("times").columns)
        named |= {"dataset": "d", "scene": "s", "frame": "f", "query": "q", "method": "slgaussian"}
        cost = {"view_seconds": seconds, "peak_bytes": 3 * 10**8}
        write_costs([named | cost], folder)
        stages, host = {"field": 4 * seconds}, {"processor": f"P{seconds}", "workers": "2"}
        times = {"seconds_by_stage": stages, "host": host}
        write_file(folder / "times.json", json.dumps(times).encode())
    (table,) = section(compared(*folders), "Costs")
    assert [tuple(cell.value for cell in row) for row in table.rows] == [
        ("d, slgaussian: query in a new view, s", "0.5000", "0.2500"),
        ("d, slgaussian: memory, MB", "300", "300"),
        ("stage field, all scenes, s", "2.00", "1.00"),
        ("processor", "P0.5", "P0.25"),
        ("workers", "2", "2"),
    ]


def test_methods_are_ranked_on_what_all_runs_were_asked_by_one_truth(tmp_path, result):
    def ranked(*folders):
        return rank_methods(dict(zip("ABC", map(read_run, folders), strict=False)))

    complete = leave(tmp_path / "all", result)
    query = scored(result)[0]["query"]
    less = leave(tmp_path / "less", result, lambda row: None if row["query"] == query else row)
    (table, *_) = ranked(complete, less)
    left = len({row["query"] for row in scored(result)} - {query})
    assert [row[-1].value for row in table.rows] == [str(left)] * 2
    small = leave(tmp_path / "b", result, lambda row: {**row, "width": row["width"] // 2})
    first, second = (
        leave(tmp_path / t, result, manifest={**MANIFEST, "data": {result.scene: {"truth": t}}})
        for t in ("aa", "bb")
    )
    for folders in ((complete, small), (first, second)):
        assert ranked(*folders) == []
    assert len(ranked(complete, first)) == len(ranked(complete))
    for folders, refusal in (
        ((complete, less, complete), "is given twice"),
        ((complete,), "found 1 run, expected 2 to 26"),
    ):
        with pytest.raises(InputError, match=refusal):
            compared(*folders)


def test_a_folder_that_no_run_left_is_named(tmp_path, result):
    with pytest.raises(InputError, match=r"samples\.parquet: found no such file, expected"):
        read_run(tmp_path)
    (tmp_path / "samples.parquet").write_bytes(b"no table")
    with pytest.raises(SpecError, match=r"samples\.parquet: .* that cannot be read"):
        read_run(tmp_path)
    folder = leave(tmp_path / "a", result)
    (folder / "manifest.json").write_text("[1]")
    with pytest.raises(InputError, match=r"manifest\.json: found no JSON object"):
        read_run(folder)
    (folder / "manifest.json").unlink()
    assert read_run(folder).manifest == {}
