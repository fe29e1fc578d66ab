"""Tables of the paper: printed numbers, and numbers of a run on the same data."""

import numpy as np
import pytest
from rows import sample

from slgaussian.benchmark.reports.model import Table
from slgaussian.benchmark.reports.paper_tables import ABSENT, ANOTHER, TABLES, paper_section
from slgaussian.benchmark.statistics import interval_of_mean

LERF, OVS3D = "lerf_ovs", "ovs3d"


def row_of(scene: str, **columns) -> dict:
    return sample(scene, **{"method": "slgaussian", "share": None, **columns})


def data_of(format: str, scene: str, published: bool = True) -> dict:
    return {"format": format, "scene": scene, "published": published}


def tables_of(rows, places, ours="slgaussian") -> list[Table]:
    section = paper_section(rows, places, ours)
    return [block for block in section.blocks if isinstance(block, Table)]


def by_title(tables, start: str):
    return next(table for table in tables if table.title.startswith(start))


def cells(table, label: str):
    """Return the printed numbers and the numbers of the run in a line."""
    (line,) = [line for line in table.lines if line.cells[0].value == label]
    return [(cell.value, cell.below) for cell in line.cells[1:]]


def numbers(place: int, title: str) -> list[float]:
    return next(one["numbers"] for one in TABLES[place]["lines"] if one["title"] == title)


@pytest.mark.parametrize("place", [0, 1])
def test_the_overall_numbers_are_the_means_of_the_scenes(place):
    """The paper says so; this finds typing errors. Tolerance: half of the last digit."""
    *scenes, overall = (np.array(line["numbers"]) for line in TABLES[place]["lines"])
    np.testing.assert_allclose(np.mean(scenes, 0), overall, atol=0.0051)


def test_without_its_data_there_is_no_number():
    rows = [row_of("teatime", iou=0.4, hit_box=True)]
    assert paper_section(rows, {}) is None
    assert paper_section(rows, {"teatime": data_of(LERF, "my kitchen", False)}) is None
    tables = tables_of(rows, {"teatime": data_of(LERF, "teatime", False)})
    assert len(tables) == 4
    for table in tables:
        numbers = {cell.below for line in table.lines for cell in line.cells[1:]}
        assert numbers <= {ABSENT, ANOTHER, "see Speed"}
    table = by_title(tables, "Table 1")
    assert {mine for _, mine in cells(table, "teatime")} == {ANOTHER}
    assert {mine for _, mine in cells(table, "ramen")} == {ABSENT}


def test_a_scene_that_was_run_has_its_number_and_the_overall_has_none():
    rows = [
        row_of("teatime-1", iou=0.2, hit_box=False),
        row_of("teatime-1", iou=0.4, hit_box=True, query="p"),
        row_of("teatime-2", iou=0.9, hit_box=True),
    ]
    teatime = data_of(LERF, "teatime")
    places = {"teatime-1": teatime, "teatime-2": teatime}
    tables = tables_of(rows, places)
    table = by_title(tables, "Table 1")
    assert "slgaussian@2 (near-best" in table.notes[0]
    assert cells(table, "teatime")[2] == ("40.65", "50.00, n 3")  # the mean over samples
    assert cells(table, "teatime")[5] == ("50.00", "66.67, n 3")
    assert cells(table, "teatime")[0] == ("21.64", "not run")
    assert cells(table, "ramen")[2] == ("55.21", ABSENT)
    assert cells(table, "overall")[2] == ("41.50", "1 of 4 scenes present")
    ablation = by_title(tables, "Table 3")
    assert cells(ablation, "feed-forward model + MA + MV-LMB") == [
        ("40.65", "50.00, n 3"),
        ("51.97", ABSENT),
    ]


def test_the_overall_is_the_mean_of_all_scenes_each_counting_once():
    lerf = TABLES[0]["lines"][-1]["scenes"]
    rows, places = [], {}
    for k, scene in enumerate(lerf):
        places[scene] = data_of(LERF, scene)
        for j in range(k + 1):
            for method in ("mine", "query-2d"):
                named = {"method": method, "query": f"q{j}"}
                rows.append(row_of(scene, iou=0.2 * k, hit_box=True, **named))
    tables = tables_of(rows, places, ours="mine")
    paper, mine = cells(by_title(tables, "Table 1"), "overall")[2]
    low, high = interval_of_mean(np.arange(4) * 20.0)
    assert (paper, mine) == ("41.50", f"30.00 ({low:.2f}–{high:.2f}), n 10")
    table = by_title(tables, "Table 4")
    assert cells(table, "SLGaussian")[0][1].startswith("30.00 (")
    assert cells(table, "2D Query")[0][1].startswith("30.00 (")
    assert cells(table, "SLGaussian")[2] == ("0.011", "see Speed")


def test_closed_set_numbers_are_those_of_their_protocol():
    rows = [
        row_of("bed", protocol="3d-ovs@2", class_iou=0.5),
        row_of("bed", iou=0.25, class_iou=0.1),
        row_of("bed", protocol="langsplat@2", iou=0.75, filter=30),
    ]
    tables = tables_of(rows, {"bed": data_of(OVS3D, "bed")})
    assert len(tables) == 8
    by_rules, by_langsplat = (t for t in tables if t.title.startswith("Table 2"))
    assert [mine for _, mine in cells(by_rules, "bed")][2::4] == ["25.00, n 1", "50.00, n 1"]
    assert cells(by_langsplat, "bed")[2][1] == "75.00, n 1"
    assert "filter 30" in by_langsplat.notes[0] and "filter" not in by_rules.notes[0]
