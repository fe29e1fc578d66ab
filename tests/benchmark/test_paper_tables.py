"""Tables of the paper: printed numbers, and numbers of a run on the same data."""

import numpy as np
import pytest
from rows import sample

from slgaussian.benchmark.reports.model import Table
from slgaussian.benchmark.reports.paper_tables import TABLES, paper_section
from slgaussian.benchmark.statistics import interval_of_mean


def make_row(scene: str, **columns) -> dict:
    return sample(scene, **{"method": "slgaussian", "share": None, **columns})


def describe_data(format: str, scene: str, published: bool = True) -> dict:
    return {"format": format, "scene": scene, "published": published}


def read_tables(rows, places, start: str, ours="slgaussian") -> list[Table]:
    """The tables whose title starts so."""
    blocks = paper_section(rows, places, ours).blocks
    return [block for block in blocks if isinstance(block, Table) and block.title.startswith(start)]


def cells(table, label: str):
    """Return the printed numbers and the numbers of the run in a row."""
    (row,) = [row for row in table.rows if row[0].value.partition(" / ")[0] == label]
    return [(cell.value, cell.below) for cell in row[1:]]


@pytest.mark.parametrize("place", [0, 1])
def test_printed_tables_have_consistent_means(place):
    """The paper says so; this finds typing errors. Tolerance: half of the last digit."""
    *scenes, overall = (np.array(line["numbers"]) for line in TABLES[place]["lines"])
    np.testing.assert_allclose(np.mean(scenes, 0), overall, atol=0.0051)


def test_paper_section_fills_cells_of_present_scenes():
    rows = [
        make_row("teatime-1", iou=0.2, hit_box=False),
        make_row("teatime-1", iou=0.4, hit_box=True, query="p"),
        make_row("teatime-2", iou=0.9, hit_box=True),
    ]
    for other in ({}, {"teatime-1": describe_data("lerf_ovs", "teatime", published=False)}):
        assert paper_section(rows, other) is None
    places = dict.fromkeys(("teatime-1", "teatime-2"), describe_data("lerf_ovs", "teatime"))
    (table,) = read_tables(rows, places, "Table 1")
    assert "slgaussian@2 (near-best" in table.notes[0]
    titles = [column.title for column in table.columns[1:3]]
    assert titles == ["IoU (%): LERF", "IoU (%): LangSplat / langsplat-like"]
    teatime = cells(table, "teatime")
    assert teatime[2] == ("40.65", "50.00, n 3")  # the mean over samples
    assert teatime[5] == ("50.00", "66.67, n 3")
    assert teatime[0] == ("21.64", "")
    assert cells(table, "ramen")[2] == ("55.21", "") and cells(table, "overall")[2] == ("41.50", "")
    (ablation,) = read_tables(rows, places, "Table 3")
    expected = [("40.65", "50.00, n 3"), ("51.97", "")]
    assert cells(ablation, "feed-forward model + MA + MV-LMB") == expected


def test_paper_section_weights_scenes_equally():
    rows, places = [], {}
    for k, line in enumerate(TABLES[0]["lines"][:-1]):
        scene = line["title"]
        places[scene] = describe_data("lerf_ovs", scene)
        for method in ("mine", "query-2d"):
            named = {"method": method, "iou": 0.2 * k, "hit_box": True}
            rows += [make_row(scene, query=f"q{j}", **named) for j in range(k + 1)]
    low, high = interval_of_mean(np.arange(4) * 20.0)
    (table,) = read_tables(rows, places, "Table 1", "mine")
    expected = f"30.00 ({low:.2f}–{high:.2f}), n 10"
    assert cells(table, "overall")[2] == ("41.50", expected)
    (table,) = read_tables(rows, places, "Table 4", "mine")
    assert cells(table, "SLGaussian")[0][1] == cells(table, "2D Query")[0][1] == expected
    assert cells(table, "SLGaussian")[2] == ("0.011", "")


def test_paper_section_uses_the_protocol_of_a_column():
    rows = [
        make_row("bed", protocol="3d-ovs@2", class_iou=0.5),
        make_row("bed", iou=0.25, class_iou=0.1),
        make_row("bed", protocol="langsplat@2", iou=0.75, filter=30),
    ]
    by_rules, by_langsplat = read_tables(rows, {"bed": describe_data("ovs3d", "bed")}, "Table 2")
    assert [mine for _, mine in cells(by_rules, "bed")][2::4] == ["25.00, n 1", "50.00, n 1"]
    assert cells(by_langsplat, "bed")[2][1] == "75.00, n 1"
