"""Tables of scores: best values, settings, numbers of samples, significance of differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rows import sample

from slgaussian.benchmark.reports.model import count_text
from slgaussian.benchmark.reports.score_tables import (
    IOU,
    conditions,
    difference_tables,
    gain_cell,
    method_tables,
)
from slgaussian.benchmark.scores import differences
from slgaussian.benchmark.statistics import LEAST, compare


def rows_of(method: str, *ious: float, **columns) -> list[dict]:
    """Return a row per scene."""
    named = {"method": method, **columns}
    return [sample(f"s{k}", iou=iou, **named) for k, iou in enumerate(ious)]


def tables_of(*groups):
    return method_tables([row for rows in groups for row in rows])


def column_of(table, title):
    """Return the cells of a column by method."""
    place = [column.title for column in table.columns].index(title)
    return {line.cells[0].value: line.cells[place] for line in table.lines}


def test_the_best_is_what_no_other_reads_better_than_and_stands_first():
    (table,) = tables_of(rows_of("c", 0.4994), rows_of("a", 0.50004), rows_of("b", 0.5))
    cells = column_of(table, "IoU")
    assert [(name, cell.value, cell.mark) for name, cell in cells.items()] == [
        ("a", "0.500", "best"),
        ("b", "0.500", "best"),
        ("c", "0.499", ""),
    ]


def test_conditions_and_samples_stand_once_and_again_where_they_differ():
    rows = rows_of("a", 0.5, 0.6), rows_of("c", 0.5, 0.6), rows_of("b", 0.1, share=0.5)
    (table,) = tables_of(*rows)
    assert (table.columns[1].title, table.columns[1].note) == ("IoU", "n 2")
    common = "near-best, share 0.7, temperature 10, phrases: lerf, absent: skip"
    assert table.notes[0] == f"slgaussian@2: {common}."
    cells = column_of(table, "IoU")
    assert "n 1" in cells["b"].note and "n 2" not in cells["a"].note
    assert [line.description for line in table.lines] == ["", "", common.replace("0.7", "0.5")]
    assert cells["a"].below == "0.500–0.600" and cells["b"].below == ""
    assert conditions(rows_of("a", None, selection="none", filter="30")[0]).startswith("no mask, ")


def test_data_sets_and_protocols_are_apart():
    other = {"protocol": "3d-ovs@2", "accuracy": 0.5}
    rows = rows_of("a", None, **other) + rows_of("a", 0.5) + rows_of("a", 0.7, dataset="e")
    tables = tables_of(rows)
    assert [table.title for table in tables] == [
        "d, protocol slgaussian@2", "e, protocol slgaussian@2", "d, protocol 3d-ovs@2"
    ]  # fmt: skip
    assert [[c.title for c in table.columns] for table in tables] == [
        ["Method", "IoU"], ["Method", "IoU"], ["Method", "Accuracy"]
    ]  # fmt: skip
    assert method_tables([]) == []


@pytest.mark.parametrize(
    ("scenes", "gain", "mark"),
    [(1, 0.1, "few"), (5, 0.1, "few"), (6, 0.1, "better"), (6, -0.1, "worse"), (6, 0.0, "noise")],
)
def test_a_difference_is_beyond_noise_or_not(scenes, gain, mark):
    ours, theirs = rows_of("a", *[0.5 + gain] * scenes), rows_of("b", *[0.5] * scenes)
    (table,) = difference_tables({"b": (ours, theirs)})
    cell = table.lines[0].cells[1]
    assert (cell.value, cell.mark) == (f"{gain:+.3f}", mark)
    assert (cell.below == "") == (scenes == 1)
    assert cell.note == f"{count_text(scenes, 'sample')} of {count_text(scenes, 'scene')}"


def test_a_difference_is_judged_as_it_is_printed():
    (table,) = difference_tables({"b": (rows_of("a", 0.5), rows_of("b", 0.50001))})
    assert table.lines[0].cells[1].value == "+0.000"
    small = rows_of("a", *[0.5004] * 6), rows_of("b", *[0.5] * 6)
    assert difference_tables({"b": small})[0].lines[0].cells[1].mark == "noise"


def claim(ours, theirs, places=None):
    """Return text and mark of the difference of two methods, from one IoU per scene."""
    rows = rows_of("mine", *ours), rows_of("query-2d, depth", *theirs)
    for method_rows in rows:
        for row, place in zip(method_rows, places or [None] * len(method_rows), strict=True):
            row["place"] = place
    (difference,) = differences(*rows)
    cell = gain_cell(difference, IOU, is_worded=True)
    return cell.text, cell.mark


STEADY = np.array([0.01, -0.01, 0.02, 0.0, -0.02, 0.01, 0.0, -0.01])


def test_scenes_are_compared_in_pairs_and_of_few_places_nothing_is_claimed():
    """The intervals of the methods overlap, but one is better in every scene."""
    theirs = np.linspace(0.1, 0.9, 8)
    assert claim(theirs + 0.02 + STEADY / 4, theirs)[1] == "better"
    text = "too few places for a test"
    pair = [0.6] * 8, [0.5] * 8
    assert claim(*pair, list("aabbccdd")) == (f"+0.100 (+0.100 to +0.100, {text})", "few")
    assert claim(*pair, list("aaaaaaaa")) == (f"+0.100 ({text})", "few")
    assert claim(*pair, list("abcdefgg"))[1] == "better"


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=10))
def test_only_an_interval_that_excludes_0_puts_one_ahead(pairs):
    ours, theirs = (np.array(scores) for scores in zip(*pairs, strict=True))
    gain = compare(ours, theirs)
    sentence, mark = claim(ours, theirs)
    sure = len(pairs) >= LEAST and (round(gain.low, 3) > 0 or round(gain.high, 3) < 0)
    assert (mark in ("better", "worse")) == sure
    assert ("significant gain" in sentence) == (sure and gain.low > 0)
    assert ("significant loss" in sentence) == (sure and gain.high < 0)
