"""The Pareto front against its definition, and the section of costs."""

import math
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st
from pages import tables_of

from slgaussian.benchmark.costs import Cost, StageCost, Times
from slgaussian.benchmark.hard_cases import HardCase
from slgaussian.benchmark.reports.model import blocks_as
from slgaussian.benchmark.reports.speed import pareto_front, speed_blocks

STEPS = st.integers(0, 4)  # few, so that many are equal


@given(st.lists(st.tuples(STEPS | st.none(), STEPS), max_size=8))
def test_the_front_is_what_no_other_beats(points):
    costs, values = [p[0] for p in points], [p[1] for p in points]
    on = pareto_front(costs, values)
    for k, (cost, value) in enumerate(points):
        beaten = cost is None
        for other, worth in points:
            if cost is not None and other is not None:
                no_worse = other <= cost and worth >= value
                beaten |= no_worse and (other, worth) != (cost, value)
        assert on[k] == (not beaten)


def test_scores_stand_beside_costs_and_hard_cases_beside_their_machine(result):
    good = HardCase("rasteriser", "needles", "long", "of alpha", 2e-7, 5e-6)
    name, other = result.dataset, "no-bank"
    times = Times(
        {"field": StageCost(1.25, 0.75, 64_000_000, 30.0), "masks": StageCost(3.75, 1.5)},
        {"machine": "a machine", "processor": "this"},
        {"this": 5, "another": 12},
        [
            Cost(name, "slgaussian", 0.5, 0.1, None, 2.0, 1_500_000_000),
            Cost(name, other, view_query=0.1),
            Cost(name, "query-2d", view_query=6.0),
        ],
        [good, replace(good, case="on its edge", error=math.nan)],
        "slgaussian",
    )
    rows = [*result.rows, *({**row, "method": other, "iou": 0.0} for row in result.rows)]
    text = blocks_as("md", speed_blocks(times, rows, [(name, "slgaussian", 20.0)]))
    scores, paper, stages, machine = tables_of(text)
    assert [line[:3] for line in paper[1:5]] == [
        ["inference per scene, s", "0.3", "0.7500"],
        ["scene, s", "25", "2.0000"],
        ["rendering, s", "0.0006", "0.4000"],
        ["query, s", "0.011", "0.5000"],
    ]
    assert [line[1:3] for line in paper[5:]] == [["18", "6.0000"], ["9", "1.5000"], ["6", "1.5000"]]
    front_of = [(line[0], line[1], line[2], *line[5:]) for line in scores[1:]]
    assert front_of == [
        ("slgaussian", f"{result.scene_metrics['iou']:.3f}", "20.0", "0.5000", "yes"),
        (other, "0.000", "–", "0.1000", "yes"),
    ]
    assert stages[1] == ["field", "0.75", "1.25", "25 %", "64"]
    assert "of 2 hard cases" in text and "**1 above the bound**: on its edge (rasteriser" in text
    assert ["results from another", "12"] in machine
    assert "took 30 s more" in text
    page = blocks_as("html", speed_blocks(times, rows, []))
    assert page.count("data:image/svg+xml") == 1 and "0.5000" in page
