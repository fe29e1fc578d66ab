"""Runs ranked: what is in one table, in which order, and on the page."""

import pytest
from left import MANIFEST, leave
from pages import check_alone

from flows.cli.app import app
from slgaussian.benchmark.comparison import read_made
from slgaussian.benchmark.run_ranking import rank_methods
from slgaussian.errors import InputError


def worse(row: dict) -> dict:
    return {**row, "iou": None if row["iou"] is None else row["iou"] * 0.5}


def tables(*folders):
    return rank_methods([read_made(folder) for folder in folders])


def test_the_better_run_stands_first_and_what_differs_is_named(tmp_path, result, capsys):
    other = {**MANIFEST, "settings": {"share": 0.5, "seed": 0}}
    low, high = leave(tmp_path / "low", result, worse, other), leave(tmp_path / "high", result)
    same = leave(tmp_path / "same", result)
    first = tables(high, low, same)[0]
    assert [(row[0], row[2]) for row in first.rows] == [
        ("1", str(high)),
        ("1", str(same)),
        ("3", str(low)),
    ]
    scores = [float(row[3].partition(" ")[0]) for row in first.rows]
    assert scores[2] < scores[0] == scores[1]
    runs, out = map(str, (high, low, same)), str(tmp_path / "out")
    app(["compare", *runs, "-o", out], standalone_mode=False)
    shown = capsys.readouterr().out
    assert first.title in shown and "settings.share: 0.7 -> 0.5" in shown
    html = (tmp_path / "out" / "compare.html").read_text("utf-8")
    check_alone(html)
    markdown = (tmp_path / "out" / "compare.md").read_text("utf-8")
    assert str(low) in html and all("settings.share" in page for page in (html, markdown))
    assert "/low |" in markdown and first.title.partition(":")[0] in html


def test_what_was_asked_something_else_or_judged_otherwise_has_its_own_table(tmp_path, result):
    whole = leave(tmp_path / "all", result)
    query = sorted({row["query"] for row in result.rows})[0]
    less = leave(tmp_path / "less", result, lambda row: None if row["query"] == query else row)
    small = leave(tmp_path / "b", result, lambda row: {**row, "width": row["width"] // 2})
    truth = {"procedural_3": {"truth": "aa"}}
    one = leave(tmp_path / "c", result, manifest={**MANIFEST, "data": truth})
    truth = {"procedural_3": {"truth": "bb"}}
    two = leave(tmp_path / "d", result, manifest={**MANIFEST, "data": truth})
    protocols = len(tables(whole))
    for others in ((whole, less), (whole, small), (one, two)):
        found = tables(*others)
        assert len(found) == 2 * protocols
        assert all([row[0] for row in table.rows] == ["1"] for table in found)
    assert len(tables(whole, one)) == protocols


def test_what_cannot_be_ranked_is_one_sentence(tmp_path, result):
    whole = leave(tmp_path / "a", result)
    with pytest.raises(InputError, match="is given twice"):
        tables(whole, whole)
    bare = leave(tmp_path / "b", result, lambda row: None)
    with pytest.raises(InputError, match="found no scored sample"):
        tables(whole, bare)
    with pytest.raises(InputError, match="found 1 run, expected two or more"):
        app(["compare", str(whole)], standalone_mode=False)
