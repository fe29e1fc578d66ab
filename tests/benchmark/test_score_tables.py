"""What is printed of scores: the best is marked, conditions and samples are said."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.benchmark.reports.score_tables import (
    MAIN,
    MORE,
    about,
    conditions,
    difference_tables,
    gain_cell,
    method_tables,
)
from slgaussian.benchmark.scores import differences, score_table
from slgaussian.benchmark.statistics import LEAST, compare
from slgaussian.storage.specs import load_spec

SETTINGS = {
    "dataset": "d",
    "frame": "f",
    "protocol": "slgaussian@2",
    "selection": "near-best",
    "temperature": 10.0,
    "share": 0.7,
    "canonical": "lerf",
    "absent": "skip",
    "note": "",
}


def rows_of(method: str, *ious: float, **more) -> list[dict]:
    """One query a scene."""
    empty = dict.fromkeys(load_spec("samples").columns)
    return [
        {**empty, **SETTINGS, "method": method, "scene": f"s{k}", "query": "q", "iou": iou, **more}
        for k, iou in enumerate(ious)
    ]


def table_of(*groups, shown=MAIN):
    rows = [row for group in groups for row in group]
    (table,) = method_tables(score_table(rows).to_pylist(), shown)
    return table


def first_cells(table):
    """The cell of the first score by method."""
    return {line.cells[0].value: line.cells[1] for line in table.lines}


def test_the_best_is_what_no_other_reads_better_than():
    table = table_of(rows_of("a", 0.50004), rows_of("b", 0.5), rows_of("c", 0.4994))
    cells = first_cells(table).values()
    assert [(cell.value, cell.mark) for cell in cells] == [
        ("0.500", "best"),
        ("0.500", "best"),
        ("0.499", ""),
    ]


def test_of_errors_the_least_is_best():
    wrong = [
        rows_of(name, 1.0, score=score, hit_mask=True) for name, score in (("a", 0.6), ("b", 0.9))
    ]
    table = table_of(*wrong, shown=MORE)
    assert table.columns[1].title == "ECE, point ↓"
    assert [cell.mark for cell in first_cells(table).values()] == ["", "best"]


def test_conditions_and_samples_are_said_once_and_again_where_they_differ():
    other = rows_of("b", 0.1, share=0.5)
    table = table_of(rows_of("a", 0.5, 0.6), rows_of("c", 0.5, 0.6), other)
    column = table.columns[1]
    assert (column.title, column.group, column.note) == ("IoU", "slgaussian@2", "n 2")
    common = "near-best, share 0.7, temperature 10, phrases: lerf, absent: skip"
    assert table.notes[0] == f"slgaussian@2: {common}."
    cells = first_cells(table)
    assert "n 1" in cells["b"].note and "n 2" not in cells["a"].note
    assert [line.about for line in table.lines] == ["", "", "share 0.5"]
    assert cells["a"].below == "0.500–0.600" and cells["b"].below == ""


def test_data_sets_are_apart_and_columns_without_a_score_are_not_there():
    rows = rows_of("a", 0.5) + rows_of("a", 0.7, dataset="e")
    tables = method_tables(score_table(rows).to_pylist())
    assert [table.title for table in tables] == ["d", "e"]
    assert [column.title for column in tables[0].columns] == ["Method", "IoU"]
    assert method_tables([]) == []


def test_a_threshold_that_was_tried_is_no_score_of_its_own():
    curve = {"protocol": "threshold-free@2", "iou_curve": [0.25] * 19, "average_precision": 0.5}
    table = table_of(rows_of("a", None, **curve))
    assert [column.title for column in table.columns] == ["Method", "AP"]


@pytest.mark.parametrize(
    ("scenes", "gain", "mark"),
    [(1, 0.1, "few"), (5, 0.1, "few"), (6, 0.1, "better"), (6, -0.1, "worse"), (6, 0.0, "noise")],
)
def test_a_difference_is_beyond_noise_or_not(scenes, gain, mark):
    ours = rows_of("a", *[0.5 + gain] * scenes)
    theirs = rows_of("b", *[0.5] * scenes)
    (table,) = difference_tables({"b": (ours, theirs)})
    cell = table.lines[0].cells[1]
    assert cell.value == f"{gain:+.3f}"
    assert cell.mark == mark
    assert (cell.below == "") == (scenes == 1)
    assert f"{scenes} samples of {scenes} scene" in cell.note


def test_nothing_is_printed_as_less_than_nothing():
    (table,) = difference_tables({"b": (rows_of("a", 0.5), rows_of("b", 0.50001))})
    assert table.lines[0].cells[1].value == "+0.000"


def test_what_ends_at_nothing_as_it_is_printed_is_noise():
    gains = [0.0004, *[0.002] * 20]
    ours = rows_of("a", *(0.5 + gain for gain in gains))
    (table,) = difference_tables({"b": (ours, rows_of("b", *[0.5] * len(gains)))})
    assert table.lines[0].cells[1].mark == "better"
    small = rows_of("a", *[0.5004] * 6)
    (table,) = difference_tables({"b": (small, rows_of("b", *[0.5] * 6))})
    assert table.lines[0].cells[1].mark == "noise"


def test_scenes_of_few_places_are_few():
    ours, theirs = (
        [row | {"place": "one"} for row in rows_of(name, *[iou] * 6)]
        for name, iou in (("a", 0.6), ("b", 0.5))
    )
    (table,) = difference_tables({"b": (ours, theirs)})
    assert (table.lines[0].cells[1].mark, table.lines[0].cells[1].below) == ("few", "")
    assert "Mean over 6 scenes" in table_of(ours).notes[1]
    assert "scenes of one place have no interval" in table_of(ours).notes[1]


def test_less_of_an_error_is_better():
    rows = [
        rows_of(name, *[None] * 6, protocol="threshold-free@2", calibration_error=error)
        for name, error in (("a", 0.1), ("b", 0.3))
    ]
    (table,) = difference_tables({"b": (rows[0], rows[1])}, MORE)
    assert (table.lines[0].cells[1].value, table.lines[0].cells[1].mark) == ("-0.200", "better")


def test_what_is_like_says_that_it_is_not_the_original():
    for name in ("lerf-like", "langsplat-like", "3d-ovs-like"):
        assert about(name).startswith("not ")
    assert about("something else") == ""


def test_conditions_of_a_protocol_without_a_mask():
    row = rows_of("a", None, selection="none", share=None, filter="30")[0]
    assert conditions(row) == "no mask, filter 30, temperature 10, phrases: lerf, absent: skip"


def claim(ours, theirs, places=None):
    """The words and mark of one method against another, by IoU of a query a scene."""
    rows = rows_of("mine", *ours), rows_of("query-2d, depth", *theirs)
    for own in rows:
        for row, place in zip(own, places or [None] * len(own), strict=True):
            row["place"] = place
    (one,) = differences(*rows)
    cell = gain_cell(one, MAIN[0], is_worded=True)
    return cell.text, cell.mark


STEADY = np.array([0.01, -0.01, 0.02, 0.0, -0.02, 0.01, 0.0, -0.01])


@pytest.mark.parametrize(
    ("step", "mark", "text"),
    [
        (0.1, "better", "ahead"),
        (-0.1, "worse", "behind"),
        (0.001, "noise", "no difference beyond noise"),
    ],
)
def test_a_method_is_ahead_behind_or_not_to_be_told_apart(step, mark, text):
    words, marked = claim(0.5 + step + STEADY, np.full(8, 0.5))
    assert marked == mark and words.startswith(f"{step:+.3f} (")
    gain = compare(0.5 + step + STEADY, np.full(8, 0.5))
    ends = f"({gain.low:+.3f} to {gain.high:+.3f}, {text})"
    assert words.endswith(ends.replace("-0.000", "+0.000"))


def test_scenes_are_compared_in_pairs():
    """Methods whose own intervals overlap by far, one always a little better."""
    theirs = np.linspace(0.1, 0.9, 8)
    assert claim(theirs + 0.02 + STEADY / 4, theirs)[1] == "better"


def test_of_few_places_nothing_is_claimed_however_many_scenes_they_have():
    ours, theirs = [0.6] * 8, [0.5] * 8
    few = "too few places to tell"
    assert claim(ours, theirs, list("aabbccdd")) == (f"+0.100 (+0.100 to +0.100, {few})", "few")
    assert claim(ours, theirs, list("aaaaaaaa")) == (f"+0.100 ({few})", "few")
    assert claim(ours, theirs, list("abcdefgg"))[1] == "better"


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=10))
def test_only_an_interval_that_excludes_0_puts_one_ahead(pairs):
    ours, theirs = (np.array(own) for own in zip(*pairs, strict=True))
    gain = compare(ours, theirs)
    sentence, mark = claim(ours, theirs)
    sure = len(pairs) >= LEAST and (round(gain.low, 3) > 0 or round(gain.high, 3) < 0)
    assert (mark in ("better", "worse")) == sure
    assert ("ahead" in sentence) == (sure and gain.low > 0)
    assert ("behind" in sentence) == (sure and gain.high < 0)
