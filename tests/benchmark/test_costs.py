"""Costs of methods: medians and peaks of the rows of `times`."""

from slgaussian.benchmark.costs import Cost, measure_costs
from slgaussian.benchmark.scores import Rows
from slgaussian.storage.specs import load_spec

EMPTY = dict.fromkeys(load_spec("times").columns)


def row(scene, frame, query, **known):
    named = {"dataset": "d", "method": "ours", "scene": scene, "frame": frame, "query": query}
    return EMPTY | named | known


ROWS = [
    # Two texts of one frame: what is of the frame or of the scene counts once.
    row("a", "1", "x", query_seconds=1.0, view_seconds=10.0, build_seconds=7.0,
        peak_bytes=130),
    row("a", "1", "y", query_seconds=3.0, view_seconds=10.0, build_seconds=7.0,
        peak_bytes=130),
    row("a", "2", "x", view_seconds=30.0, build_seconds=7.0, peak_bytes=130),
    row("b", "1", "x", query_seconds=8.0, view_seconds=20.0, build_seconds=9.0,
        peak_bytes=150),
]  # fmt: skip


def test_costs_are_medians_of_measurements_and_the_largest_peak():
    other = row("a", "1", "x", method="other", query_seconds=2.0, prepare_seconds=4.0)
    ours, theirs = measure_costs(Rows.from_rows([*ROWS, other], "times"))
    assert ours == Cost("d", "ours", 20.0, 3.0, None, 8.0, 150)
    assert theirs == Cost("d", "other", None, 2.0, 4.0, None, None)
    assert measure_costs(Rows.from_rows([], "times")) == []
