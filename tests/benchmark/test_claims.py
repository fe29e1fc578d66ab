"""A method is called ahead only where a paired interval excludes 0, by rule."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.benchmark.score_tables import difference_tables
from slgaussian.benchmark.statistics import LEAST, compare
from slgaussian.benchmark.verdict import claims
from slgaussian.storage.specs import load_spec

COMMON = {
    "dataset": "d",
    "frame": "f",
    "query": "q",
    "protocol": "slgaussian@2",
    "selection": "near-best",
    "temperature": 10.0,
    "canonical": "lerf",
    "absent": "skip",
    "note": "",
}


def rows_of(method: str, ious, places=None, **more) -> list[dict]:
    empty = dict.fromkeys(load_spec("samples").columns)
    places = places or [None] * len(ious)
    return [
        {**empty, **COMMON, "method": method, "scene": f"s{k}", "place": place, "iou": iou, **more}
        for k, (iou, place) in enumerate(zip(ious, places, strict=True))
    ]


def claim(ours, theirs, places=None):
    rows = rows_of("mine", ours, places), rows_of("query-2d, depth", theirs, places)
    (table,) = difference_tables({"query-2d, depth": rows})
    (only,) = claims(table)
    return only


STEADY = np.array([0.01, -0.01, 0.02, 0.0, -0.02, 0.01, 0.0, -0.01])


@pytest.mark.parametrize(
    ("step", "mark", "text"),
    [
        (0.1, "better", "ahead of query-2d, depth by +0.100 ("),
        (-0.1, "worse", "behind query-2d, depth: -0.100 ("),
        (0.001, "noise", "no difference beyond noise from query-2d, depth: +0.001 ("),
    ],
)
def test_it_is_ahead_behind_or_not_to_be_told_apart(step, mark, text):
    found = claim(0.5 + step + STEADY, np.full(8, 0.5))
    assert found.mark == mark and found.text.startswith(text)
    gain = compare(0.5 + step + STEADY, np.full(8, 0.5))
    assert found.text.endswith(f"({gain.low:+.3f} to {gain.high:+.3f})".replace("-0.000", "+0.000"))


def test_scenes_are_compared_in_pairs():
    """Methods whose own intervals overlap by far, one always a little better."""
    theirs = np.linspace(0.1, 0.9, 8)
    assert claim(theirs + 0.02 + STEADY / 4, theirs).mark == "better"


def test_fewer_places_than_are_needed_tell_nothing_however_many_scenes_they_have():
    ours, theirs = [0.6] * 8, [0.5] * 8
    few = claim(ours, theirs, list("aabbccdd"))
    assert (few.mark, few.text) == (
        "few",
        "too few places to tell from query-2d, depth: +0.100 (+0.100 to +0.100)",
    )
    assert claim(ours, theirs, list("aaaaaaaa")).text == (
        "too few places to tell from query-2d, depth: +0.100"
    )
    assert claim(ours, theirs, list("abcdefgg")).mark == "better"


def test_of_many_that_nothing_is_borne_out_of_one_line_says_so():
    ours, places = rows_of("mine", [0.6] * 8, list("aabbccdd")), list("aabbccdd")
    others = {name: (ours, rows_of(name, [0.5] * 8, places)) for name in ("x", "y", "z")}
    (table,) = difference_tables(others)
    assert [one.text for one in claims(table)] == [
        "too few places to tell from any of the 3 others"
    ]
    (table,) = difference_tables({name: others[name] for name in "xy"})
    assert [one.mark for one in claims(table)] == ["few", "few"]


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=10))
def test_only_an_interval_that_excludes_0_puts_one_ahead(pairs):
    ours, theirs = (np.array(own) for own in zip(*pairs, strict=True))
    gain = compare(ours, theirs)
    found = claim(ours, theirs)
    sure = len(pairs) >= LEAST and (round(gain.low, 3) > 0 or round(gain.high, 3) < 0)
    assert (found.mark in ("better", "worse")) == sure
    assert ("ahead of" in found.text) == (sure and gain.low > 0)
    assert ("behind" in found.text) == (sure and gain.high < 0)


def test_without_that_score_nothing_is_claimed():
    more = {"protocol": "3d-ovs@2", "class_iou": 0.5}
    rows = [rows_of(method, [None] * 8, **more) for method in ("mine", "other")]
    (table,) = difference_tables({"other": tuple(rows)})
    assert claims(table) == []
