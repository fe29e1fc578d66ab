"""What numbers of context views are worth: paired gains over the scenes that have all of them."""

import numpy as np
import pytest
from pages import Page, check_alone, tables_of

from slgaussian.benchmark.statistics import compare
from slgaussian.benchmark.view_counts import SHOWN, counts_of, render_view_counts

PSNR = {2: [20.0, 22.0, 24.0], 4: [21.0, 22.5, 23.0], 8: [25.0, 26.0, 27.0]}
ERROR = {2: [0.2, 0.3, 0.4], 4: [0.1, 0.2, 0.3], 8: [0.1, 0.2, 0.45]}


def row(scene, views, psnr, error=None, place=None, dataset="walk"):
    scores = dict.fromkeys(SHOWN) | {"psnr": psnr, "ssim": psnr / 30, "target_abs_rel": error}
    common = {"dataset": dataset, "scene": scene, "place": place, "views": views}
    return common | {"context": "a, b", "gaussians": 1000 * views, "kept": 300 * views} | scores


def rows_of(**more):
    return [
        row(f"scene_{k}", views, psnr, ERROR[views][k], **more)
        for views, own in PSNR.items()
        for k, psnr in enumerate(own)
    ]


def seconds_of(rows):
    return {(each["scene"], each["views"]): 1.5 * each["views"] for each in rows}


def counts(rows):
    return counts_of(rows, seconds_of(rows))


def test_gains_are_paired_and_the_worst_scene_is_said():
    (found,) = counts(rows_of())
    assert [line.views for line in found.lines] == [2, 4, 8]
    assert [column.key for column in found.columns] == ["psnr", "ssim", "target_abs_rel"]
    two, four, eight = (line.cells[0] for line in found.lines)
    assert (two.value, two.interval) == ("22.0", "")
    gain = compare(PSNR[4], PSNR[2])
    assert four.interval == f"+0.17 ({gain.low:+.2f} to {gain.high:+.2f}), worst -1.00"
    assert eight.value == "26.0" and eight.interval.endswith("worst +3.00")
    assert [line.gaussians for line in found.lines] == [2000, 4000, 8000]
    assert [line.kept for line in found.lines] == [600, 1200, 2400]
    assert [line.grown for line in found.lines] == [1, 2, 4]
    assert [line.seconds for line in found.lines] == [3, 6, 12]


def test_of_an_error_the_worst_scene_is_the_one_where_it_grows():
    (found,) = counts(rows_of())
    assert found.lines[2].cells[2].interval.endswith("worst +0.0500")


def test_a_mark_is_beyond_noise_of_six_scenes_at_least():
    rows = [row(f"s{k}", n, 20 + n, 0.5 - n / 20) for k in range(6) for n in (2, 4)]
    (found,) = counts(rows)
    assert [cell.mark for cell in found.lines[1].cells] == ["better"] * 3
    rows = [row(f"s{k}", n, 20 - n, 0.1 + n / 20) for k in range(6) for n in (2, 4)]
    assert [cell.mark for cell in counts(rows)[0].lines[1].cells] == ["worse"] * 3
    rows = [row(f"s{k}", n, 20 + n * (-1) ** k) for k in range(6) for n in (2, 4)]
    assert counts(rows)[0].lines[1].cells[0].mark == "noise"
    assert {cell.mark for cell in counts(rows_of())[0].lines[1].cells} == {"few"}


def test_only_scenes_with_all_numbers_count():
    rows = [*rows_of(), row("two_only", 2, 50.0, 0.1), row("elsewhere", 2, 50.0, dataset="other")]
    assert counts(rows) == counts(rows_of())


def test_scenes_of_one_place_have_no_interval_and_two_places_are_drawn_whole():
    (found,) = counts(rows_of(place="attic"))
    assert (found.scenes, found.places) == (3, 1)
    assert found.lines[1].cells[0].interval == "+0.17, worst -1.00"


def test_a_number_without_a_score_has_a_dash():
    rows = rows_of()
    for each in rows:
        if each["views"] == 4:
            each["target_abs_rel"] = None
    (found,) = counts(rows)
    assert found.lines[1].cells[2].value == "–"
    render_view_counts(rows, seconds_of(rows), [], "said")


@pytest.fixture(scope="module")
def report():
    rows = rows_of()
    lost = [{"scene": "attic <1>", "stage": "views", "reason": "found 3, expected 8"}]
    return render_view_counts(rows, seconds_of(rows), lost, "Built with a part")


def test_the_page_stands_alone_and_has_its_charts(report):
    check_alone(report.html)
    page = Page(report.html)
    assert page.tags.count("svg") == 2
    assert "attic <1>" in page.text and "found 3, expected 8" in page.text
    for folder in ("views_2", "views_4", "views_8"):
        assert f'href="{folder}/report.html"' in report.html


def test_the_markdown_has_the_same_numbers(report):
    left_out, table = tables_of(report.markdown)
    assert left_out[1][0] == "attic <1>"
    assert [line[0] for line in table[1:]] == ["2", "4", "8"]
    means = [float(line[1].split()[0]) for line in table[1:]]
    np.testing.assert_allclose(means, [np.mean(own) for own in PSNR.values()], atol=0.05)


def test_the_same_numbers_give_the_same_bytes(report):
    rows = rows_of()
    lost = [{"scene": "attic <1>", "stage": "views", "reason": "found 3, expected 8"}]
    assert render_view_counts(rows, seconds_of(rows), lost, "Built with a part") == report
