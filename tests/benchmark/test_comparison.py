"""Two report folders: what differs, by how much, and where."""

import json
from pathlib import Path

import numpy as np
import pytest
from left import MANIFEST, leave
from pages import Page, check_alone, tables_of

from slgaussian.benchmark.comparison import (
    BOTH,
    FIRST,
    NEITHER,
    SECOND,
    compare_reports,
    mask_change,
    read_made,
    render_comparison,
)
from slgaussian.benchmark.outputs import (
    mask_place,
    write_costs,
    write_file,
)
from slgaussian.errors import InputError, SpecError
from slgaussian.storage.specs import load_spec


def compared(first: Path, second: Path):
    return compare_reports(read_made(first), read_made(second))


def scored(result) -> list[dict]:
    return [r for r in result.rows if r["protocol"] == "slgaussian@2" and r["iou"] is not None]


def test_a_report_and_itself_differ_in_nothing(tmp_path, result):
    folder = leave(tmp_path / "a", result)
    found = compared(folder, folder)
    samples = len(result.rows)
    assert found.said == f"{samples} samples of 1 method are in both, and all are the same"
    assert found.settings == [] and found.changes == []
    for table in (*found.tables, *found.more):
        assert {float(cell.value) for line in table.lines for cell in line.cells} == {0.0}


def test_what_changed_is_found(tmp_path, result):
    worse = scored(result)[0]["query"]

    def change(row):
        if row["query"] == worse and row["protocol"] == "slgaussian@2" and row["iou"] is not None:
            row["iou"] -= 0.25
        return row

    first = leave(tmp_path / "a", result)
    second = leave(tmp_path / "b", result, change)
    found = compared(first, second)
    assert ", 1 of them changed" in found.said
    (gain,) = (line.cells[0].value for table in found.tables for line in table.lines)
    assert gain == f"{-0.25 / len(scored(result)):+.3f}"
    (most,) = found.changes
    assert (most.row["query"], round(most.second - most.first, 6)) == (worse, -0.25)
    mask = result.predictions["slgaussian@2", "view_01", worse]
    assert np.array_equal(most.picture, mask_change(mask, mask))
    back = compared(second, first)
    assert back.tables[0].lines[0].cells[0].value == gain.replace("-", "+")


def test_what_they_were_made_with_is_compared(tmp_path, result):
    other = {
        **MANIFEST,
        "settings": {"share": 0.5, "seed": 0},
        "methods": {"query-2d": "query-2d", "lerf-like": "lerf-like"},
        "data": {"procedural_3": {"sample": "aa", "files": {"a.png": "22"}}, "new": {}},
    }
    first = leave(tmp_path / "a", result)
    found = compared(first, leave(tmp_path / "b", result, manifest=other))
    assert found.settings == [
        ("settings.share", "0.7", "0.5"),
        ("methods", "–", "lerf-like"),
        ("data.procedural_3.files.a.png", "11", "22"),
        ("data.new", "–", "present"),
    ]


def test_data_that_differ_in_many_scenes_take_one_line(tmp_path, result):
    several = [
        {**MANIFEST, "data": {f"s{k}": {"sample": f"{k}{side * 70}"} for k in range(5)}}
        for side in "ab"
    ]
    first, second = (
        leave(tmp_path / name, result, manifest=one)
        for name, one in zip("ab", several, strict=True)
    )
    assert compared(first, second).settings == [
        (
            "data.*.sample",
            "0aaaaaaaaaaa… of s0, and others of 4 more scenes",
            "0bbbbbbbbbbb… of s0, and others of 4 more scenes",
        )
    ]


def test_queries_of_one_report_alone_are_counted_and_not_compared(tmp_path, result):
    left_out = scored(result)[0]["query"]
    second = leave(tmp_path / "b", result, lambda row: None if row["query"] == left_out else row)
    found = compared(leave(tmp_path / "a", result), second)
    gone = sum(row["query"] == left_out for row in result.rows)
    assert f"{gone} more in {tmp_path / 'a'}" in found.said
    assert str(tmp_path / "b") not in found.said


def test_own_methods_of_other_names_are_compared(tmp_path, result):
    second = leave(tmp_path / "b", result, lambda row: {**row, "method": "mine"})
    found = compared(leave(tmp_path / "a", result), second)
    assert found.tables[0].lines[0].method == "mine − slgaussian"
    assert "all are the same" in found.said


def test_samples_judged_at_two_sizes_are_not_compared(tmp_path, result):
    first = leave(tmp_path / "a", result)
    second = leave(tmp_path / "b", result, lambda row: {**row, "width": row["width"] // 2})
    found = compared(first, second)
    assert not found.tables and not found.changes
    assert "no query of the same frame, judged at the same size, is in both" in found.said


def test_what_both_cost_stands_side_by_side(tmp_path, result):
    folders = leave(tmp_path / "a", result), leave(tmp_path / "b", result)
    assert compared(*folders).costs == []
    for folder, seconds in zip(folders, (0.5, 0.25), strict=True):
        named = dict.fromkeys(load_spec("times").columns)
        named |= {"dataset": "d", "scene": "s", "frame": "f", "query": "q", "method": "slgaussian"}
        cost = {"view_seconds": seconds, "held_bytes": 10**8, "peak_bytes": 3 * 10**8}
        write_costs([named | cost], folder)
        stages, host = {"field": 4 * seconds}, {"processor": f"P{seconds}", "workers": "2"}
        times = {"seconds_by_stage": stages, "host": host}
        write_file(folder / "times.json", json.dumps(times).encode())
    found = compared(*folders)
    assert found.costs == [
        ("d, slgaussian: a query in a new view, s", "0.5000", "0.2500"),
        ("d, slgaussian: memory, MB", "200", "200"),
        ("field of all scenes, s", "2.00", "1.00"),
        ("machine", "–", "–"),
        ("processor", "P0.5", "P0.25"),
        ("workers", "2", "2"),
    ]
    page, markdown = render_comparison(found)
    for text in (Page(page).text, markdown):
        assert "0.2500" in text and "P0.25" in text


def test_nothing_in_common_is_one_sentence(tmp_path, result):
    second = leave(tmp_path / "b", result, lambda row: {**row, "dataset": "attic", "scene": "x"})
    found = compared(leave(tmp_path / "a", result), second)
    assert found.said.startswith("nothing to compare: ")
    assert "1 scene(s) of attic (x)" in found.said and "procedural_3" in found.said
    assert found.tables == [] and found.changes == []
    empty = leave(tmp_path / "c", result, lambda row: None)
    assert "has no samples" in compared(empty, second).said
    page, text = render_comparison(found)
    assert "nothing to compare" in Page(page).text and "nothing to compare" in text


def test_the_pages_say_the_same_and_need_nothing_else(tmp_path, result):
    def change(row):
        return {**row, "iou": None if row["iou"] is None else row["iou"] / 2}

    first = leave(tmp_path / "a", result)
    found = compared(first, leave(tmp_path / "b", result, change, {**MANIFEST, "seed": "<b>"}))
    page, text = render_comparison(found)
    check_alone(page)
    assert (page, text) == render_comparison(found)
    shown = Page(page)
    assert len(shown.images) == len(found.changes) > 0
    assert "<b>" in shown.text
    table = next(t for t in tables_of(text) if t[0][0] == "Protocol")
    values = [cell.value for cell in found.tables[0].lines[0].cells]
    assert [row[2].split()[0] for row in table[1:]] == values
    for value in values:
        assert value in shown.text


def test_without_masks_there_is_no_picture(tmp_path, result):
    def change(row):
        return {**row, "iou": None if row["iou"] is None else row["iou"] / 2}

    first, second = leave(tmp_path / "a", result), leave(tmp_path / "b", result, change)
    for row in scored(result):
        (second / "predictions" / mask_place(row)).unlink()
    found = compared(first, second)
    assert found.changes and all(change.picture is None for change in found.changes)
    Page(render_comparison(found)[0])


def test_colours_say_whose_a_pixel_is():
    first = np.array([[False, True, False, True]])
    second = np.array([[False, False, True, True]])
    assert mask_change(first, second)[0].tolist() == list(map(list, (NEITHER, FIRST, SECOND, BOTH)))


def test_what_is_no_report_is_named(tmp_path, result):
    with pytest.raises(InputError, match=r"samples\.parquet: found no such file, expected"):
        read_made(tmp_path)
    (tmp_path / "samples.parquet").write_bytes(b"no table")
    with pytest.raises(InputError, match=r"samples\.parquet: cannot be read"):
        read_made(tmp_path)
    folder = leave(tmp_path / "a", result)
    (folder / "manifest.json").write_text("[1]")
    with pytest.raises(InputError, match=r"manifest\.json: found no JSON object"):
        read_made(folder)
    (folder / "manifest.json").unlink()
    assert read_made(folder).manifest == {}
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "samples.parquet").write_bytes((folder / "scores.parquet").read_bytes())
    with pytest.raises(SpecError, match="no such column"):
        read_made(tmp_path / "b")
