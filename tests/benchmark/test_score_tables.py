"""Tables of scores: best values, settings, significance of differences."""

import numpy as np
import pytest
from rows import sample

from slgaussian.benchmark.reports.score_tables import difference_tables, method_tables
from slgaussian.benchmark.scores import Rows, differences


def make_rows(method: str, *ious: float, places=None, **columns) -> list[dict]:
    """Return a row per scene."""
    places = places or [None] * len(ious)
    return [
        sample(f"s{k}", iou=iou, place=place, method=method, **columns)
        for k, (iou, place) in enumerate(zip(ious, places, strict=True))
    ]


def test_method_tables_mark_and_rank_the_best():
    rows = make_rows("c", 0.4994) + make_rows("a", 0.50004) + make_rows("b", 0.5, share=0.5)
    (table,) = method_tables(Rows.from_rows(rows))
    assert [(row[0].value, row[1].value, row[1].mark) for row in table.rows] == [
        ("a", "0.500", "best"),
        ("b", "0.500", "best"),
        ("c", "0.499", ""),
    ]
    common = "near-best, share 0.7, temperature 10, phrases: lerf, absent: skip"
    assert table.notes[:2] == [f"slgaussian@2: {common}.", f"b: {common.replace('0.7', '0.5')}."]


def test_method_tables_separate_data_sets_and_protocols():
    other = {"protocol": "3d-ovs@2", "accuracy": 0.5}
    rows = make_rows("a", None, **other) + make_rows("a", 0.5) + make_rows("a", 0.7, dataset="e")
    tables = method_tables(Rows.from_rows(rows))
    assert [(table.title, table.columns[1].title) for table in tables] == [
        ("d, protocol slgaussian@2", "IoU"),
        ("e, protocol slgaussian@2", "IoU"),
        ("d, protocol 3d-ovs@2", "Accuracy"),
    ]
    assert method_tables(Rows.from_rows([])) == []


STEADY = np.array([0.01, -0.01, 0.02, 0.0, -0.02, 0.01, 0.0, -0.01])
SPREAD = np.linspace(0.1, 0.9, 8)


@pytest.mark.parametrize(
    ("ours", "theirs", "places", "cell"),
    [
        ([0.6], [0.5], "a", ("+0.100", "few")),
        ([0.6] * 5, [0.5] * 5, "abcde", ("+0.100", "few")),
        ([0.6] * 6, [0.5] * 6, "abcdef", ("+0.100", "better")),
        ([0.4] * 6, [0.5] * 6, "abcdef", ("-0.100", "worse")),
        ([0.5] * 6, [0.50001] * 6, "abcdef", ("+0.000", "noise")),
        ([0.5004] * 6, [0.5] * 6, "abcdef", ("+0.000", "noise")),  # judged as it is printed
        # The intervals of the methods overlap, but one is better in every scene.
        (SPREAD + 0.02 + STEADY / 4, SPREAD, "abcdefgh", ("+0.020", "better")),
        ([0.6] * 8, [0.5] * 8, "aabbccdd", ("+0.100", "few")),  # of few places
        ([0.6] * 8, [0.5] * 8, "abcdefgg", ("+0.100", "better")),
    ],
)
def test_difference_tables_mark_significance(ours, theirs, places, cell):
    pair = make_rows("a", *ours, places=places), make_rows("b", *theirs, places=places)
    (difference,) = found = differences(*pair)
    (table,) = difference_tables({"b": found})
    gain = table.rows[0][1]
    assert (gain.value, gain.mark) == cell
    assert (gain.below == "") == (len(set(places)) == 1)
    if gain.mark == "better":
        assert difference.gain.low > 0
