"""What is printed of scores: the best is marked, conditions and samples are said."""

import pytest

from slgaussian.benchmark.score_tables import (
    MAIN,
    MORE,
    about,
    conditions,
    difference_tables,
    method_tables,
)
from slgaussian.benchmark.scores import score_table
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


def table_of(*groups, columns=MAIN):
    rows = [row for group in groups for row in group]
    (table,) = method_tables(score_table(rows).to_pylist(), columns)
    return table


def test_the_best_is_what_no_other_reads_better_than():
    table = table_of(rows_of("a", 0.50004), rows_of("b", 0.5), rows_of("c", 0.4994))
    assert [line.cells[0].mark for line in table.lines] == ["best", "best", ""]
    assert [line.cells[0].value for line in table.lines] == ["0.500", "0.500", "0.499"]


def test_of_errors_the_least_is_best():
    wrong = [
        rows_of(name, 1.0, score=score, hit_mask=True) for name, score in (("a", 0.6), ("b", 0.9))
    ]
    table = table_of(*wrong, columns=MORE)
    assert table.columns[0].sign < 0
    assert [line.cells[0].mark for line in table.lines] == ["", "best"]


def test_conditions_and_samples_are_said_once_and_again_where_they_differ():
    other = rows_of("b", 0.1, share=0.5)
    table = table_of(rows_of("a", 0.5, 0.6), rows_of("c", 0.5, 0.6), other)
    (group,) = table.groups
    assert group.protocol == "slgaussian@2"
    assert group.conditions == ("near-best, share 0.7, temperature 10, phrases: lerf, absent: skip")
    assert group.counts == ("n 2",)
    notes = {line.method: line.cells[0].note for line in table.lines}
    assert "share 0.5" in notes["b"] and "n 1" in notes["b"]
    assert "share" not in notes["a"]
    assert {line.method: line.by for line in table.lines} == {"a": "", "c": "", "b": "share 0.5"}
    cells = {line.method: line.cells[0] for line in table.lines}
    assert cells["a"].interval == "0.500–0.600" and cells["b"].interval == ""


def test_data_sets_are_apart_and_columns_without_a_score_are_not_there():
    rows = rows_of("a", 0.5) + rows_of("a", 0.7, dataset="e")
    tables = method_tables(score_table(rows).to_pylist())
    assert [table.dataset for table in tables] == ["d", "e"]
    assert [column.title for column in tables[0].columns] == ["IoU"]
    assert method_tables([]) == []


def test_a_threshold_that_was_tried_is_no_score_of_its_own():
    curve = {"protocol": "threshold-free@2", "iou_curve": [0.25] * 19, "average_precision": 0.5}
    table = table_of(rows_of("a", None, **curve))
    assert [column.title for column in table.columns] == ["AP"]


@pytest.mark.parametrize(
    ("scenes", "gain", "mark"),
    [(1, 0.1, "few"), (5, 0.1, "few"), (6, 0.1, "better"), (6, -0.1, "worse"), (6, 0.0, "noise")],
)
def test_a_difference_is_beyond_noise_or_not(scenes, gain, mark):
    ours = rows_of("a", *[0.5 + gain] * scenes)
    theirs = rows_of("b", *[0.5] * scenes)
    (table,) = difference_tables({"b": (ours, theirs)})
    cell = table.lines[0].cells[0]
    assert cell.value == f"{gain:+.3f}"
    assert cell.mark == mark
    assert (cell.interval == "") == (scenes == 1)
    assert f"{scenes} samples of {scenes} scene" in cell.note


def test_nothing_is_printed_as_less_than_nothing():
    (table,) = difference_tables({"b": (rows_of("a", 0.5), rows_of("b", 0.50001))})
    assert table.lines[0].cells[0].value == "+0.000"


def test_what_ends_at_nothing_as_it_is_printed_is_noise():
    gains = [0.0004, *[0.002] * 20]
    ours = rows_of("a", *(0.5 + gain for gain in gains))
    (table,) = difference_tables({"b": (ours, rows_of("b", *[0.5] * len(gains)))})
    assert table.lines[0].cells[0].mark == "better"
    small = rows_of("a", *[0.5004] * 6)
    (table,) = difference_tables({"b": (small, rows_of("b", *[0.5] * 6))})
    assert table.lines[0].cells[0].mark == "noise"


def test_scenes_of_few_places_are_few():
    ours, theirs = (
        [row | {"place": "one"} for row in rows_of(name, *[iou] * 6)]
        for name, iou in (("a", 0.6), ("b", 0.5))
    )
    (table,) = difference_tables({"b": (ours, theirs)})
    assert (table.scenes, table.places) == (6, 1)
    assert (table.lines[0].cells[0].mark, table.lines[0].cells[0].interval) == ("few", "")
    assert (table_of(ours).scenes, table_of(ours).places) == (6, 1)


def test_less_of_an_error_is_better():
    rows = [
        rows_of(name, *[None] * 6, protocol="threshold-free@2", calibration_error=error)
        for name, error in (("a", 0.1), ("b", 0.3))
    ]
    (table,) = difference_tables({"b": (rows[0], rows[1])}, MORE)
    assert (table.lines[0].cells[0].value, table.lines[0].cells[0].mark) == ("-0.200", "better")


def test_what_is_like_says_that_it_is_not_the_original():
    for name in ("lerf-like", "langsplat-like", "3d-ovs-like", "segsplat-like"):
        assert about(name).startswith("not ")
    assert about("something else") == ""


def test_conditions_of_a_protocol_without_a_mask():
    row = rows_of("a", None, selection="none", share=None, filter="30")[0]
    assert conditions(row) == "no mask, filter 30, temperature 10, phrases: lerf, absent: skip"
