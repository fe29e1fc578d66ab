"""The Pareto front against its definition, and the section of costs."""

import base64
import re
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st
from pages import Page, read_tables

from slgaussian.benchmark.costs import Cost, StageCost, Times
from slgaussian.benchmark.reports.model import Section, append_section
from slgaussian.benchmark.reports.speed import pareto_front, speed_blocks
from slgaussian.benchmark.scores import Rows

STEPS = st.integers(0, 4)  # few, so that many are equal


@given(st.lists(st.tuples(STEPS, STEPS), max_size=8))
def test_pareto_front_equals_its_definition(points):
    for x, y in points:
        beaten = any((a, b) != (x, y) and a <= x and b <= y for a, b in points)
        assert ((x, y) in pareto_front(points)) == (not beaten)


def test_speed_blocks_show_scores_costs_and_the_paper(result):
    name, other = result.dataset, "no-bank"
    times = Times(
        {"field": StageCost(1.25, 0.75, 30.0), "masks": StageCost(3.75, 1.5)},
        {"machine": "a machine", "processor": "this"},
        [
            Cost(name, "slgaussian", 0.5, 0.1, None, 2.0, 1_500_000_000),
            Cost(name, other, 0.1, None, 5.0, 2.0),
            Cost(name, "query-2d", view_query=6.0),
        ],
        "slgaussian",
    )
    others = ({**row, "method": other, "iou": 0.0} for row in result.rows)
    rows = Rows.from_rows([*result.rows, *others])
    section = Section("Speed", speed_blocks(times, rows, [(name, "slgaussian", 20.0)]), "times")
    text = append_section("# Report\n", "md", section)
    scores, paper, stages, machine = read_tables(text)
    assert [line[1:3] for line in paper[1:]] == [
        ["0.3", "0.7500"], ["25", "2.0000"], ["0.0006", "0.4000"], ["0.011", "0.5000"],
        ["18", "6.0000"], ["9", "1.5000"], ["6", "1.5000"],
    ]  # fmt: skip
    assert [(line[0], line[1], line[2], *line[5:]) for line in scores[1:]] == [
        ("slgaussian", f"{result.scene_metrics['iou']:.3f}", "20.0", "0.5000", "scene, query"),
        (other, "0.000", "–", "0.1000", "query"),
        ("query-2d", "–", "–", "6.0000", ""),
    ]
    assert stages[1] == ["field", "0.75", "1.25", "25 %"]
    assert machine[1:] == [["machine", "a machine"], ["processor", "this"]]
    assert "took 30 s more" in text
    page = append_section("<nav></nav><main></main>", "html", section)
    assert '<a href="#times">' in page
    ours, theirs = read_points(Page(page).images[0]["src"])
    # Ours takes fewer seconds and has the smaller error, below in an SVG as y points down.
    assert ours[0] < theirs[0] and ours[1] > theirs[1]

    untimed = [Cost(name, "slgaussian"), Cost(name, other)]
    speed_blocks(replace(times, costs=untimed), rows, [])  # no time, and so no figure


def read_points(source: str) -> list[tuple[float, ...]]:
    """Return the positions of the markers of methods in the data URI of a figure."""
    svg = base64.b64decode(source.partition(",")[2]).decode()
    marks = re.findall(r'id="method-\d+">.*?<use [^>]*x="([\d.]+)" y="([\d.]+)"', svg, re.DOTALL)
    return [tuple(map(float, mark)) for mark in marks]
