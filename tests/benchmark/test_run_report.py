"""The report of a run as HTML and Markdown."""

import re
from dataclasses import replace

import numpy as np
import pytest
from pages import Page, check_alone, read_tables

from slgaussian.benchmark.costs import Cost, Times
from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.benchmark.reports.examples import Scene, choose_example, worst_answers
from slgaussian.benchmark.reports.model import Report, plain
from slgaussian.benchmark.reports.run_report import run_report, with_times
from slgaussian.benchmark.scores import Rows, score_table
from slgaussian.language.wholes import NEAR_BEST
from slgaussian.storage.specs import load_spec

MANIFEST = {"slgaussian": "0.1.0", "settings": {"replicas": 5}}


@pytest.fixture(scope="module")
def truth(room):
    return room.strange_truth


def make_scene(result: SceneResult, truth, name: str = "") -> Scene:
    data = (lambda: result.pictures), (lambda: truth), (lambda: result.predictions)
    return Scene(name or result.scene, result.dataset, result.scene_metrics, *data)


def report_one(result, truth, rivals=(), *details, name: str = "") -> Report:
    """Make the report of one scene, with rows of other methods."""
    scene = make_scene(result, truth, name)
    rows = Rows.from_rows({**row, "scene": scene.name} for row in (*result.rows, *rivals))
    return run_report([scene], rows, MANIFEST, *details)


def make_report(result, truth) -> Report:
    """Make the report of one scene by two methods, of which the other has half the scores."""
    half = [
        {**row, "method": "query-2d"}
        | {k: row[k] / 2 for k in ("iou", "boundary_iou", "class_iou") if row[k] is not None}
        for row in result.rows
    ]
    return report_one(result, truth, half)


@pytest.fixture(scope="module")
def both(result, truth) -> Report:
    return make_report(result, truth)


def test_run_report_is_deterministic(both, result, truth):
    repeated = make_report(result, truth)
    assert (repeated.as_html(), repeated.as_markdown()) == (both.as_html(), both.as_markdown())


def leading(result):
    return [row for row in result.rows if row["protocol"] == "slgaussian@2"]


def test_run_report_has_numbers_and_conditions_in_both_forms(both, result):
    check_alone(both.as_html())
    page = Page(both.as_html())
    scores = {s["metric"]: s for s in score_table(leading(result)).to_pylist()}
    iou, samples = scores["iou"]["value"], scores["iou"]["samples"]
    table = next(t for t in read_tables(both.as_markdown()) if t[0][0] == "Method")
    assert table[0][1] == "IoU" and table[0][-2:] == ["slgaussian minus method", "Queries"]
    assert [[*row[:2], *row[-2:]] for row in table[1:]] == [
        ["slgaussian", f"**{iou:.3f}**", "–", str(samples)],
        ["query-2d", f"{iou / 2:.3f}", f"{iou / 2:+.3f}", str(samples)],
    ]
    for number in re.findall(r"[\d.]+", " ".join(table[1] + table[2])):
        assert number in page.text
    assert f"slgaussian@2: near-best, share {NEAR_BEST}, temperature 10" in page.text
    for key, digits in (("psnr", 1), ("abs_rel", 3)):
        assert f"{result.scene_metrics[key]:.{digits}f}" in page.text
    assert f"{samples} queries scored, compared with 1 baseline" in page.text
    assert f"{iou:.3f} best baseline: {iou / 2:.3f}, query-2d" in page.text
    assert "does not understand (IoU 0): 1" in page.text


def test_with_times_appends_a_section_only(both, result):
    pages = {"html": both.as_html(), "md": both.as_markdown()}
    cost = Cost(result.dataset, "slgaussian", view_query=0.1234, build=12.3)
    complete = with_times(
        pages, Times({}, {"machine": "a machine"}, costs=[cost]), Rows.from_rows(result.rows)
    )
    assert complete["md"].startswith(pages["md"]) and "0.1234" in complete["md"]
    page = Page(complete["html"])
    assert "0.1234" in page.text and page.text.index("a machine") > page.text.index("Configuration")


OFF_SCREEN = """(() => {
  document.querySelectorAll("details").forEach(fold => { fold.open = true; });
  return [...document.querySelectorAll("body, section, figure, table, th, td, p, nav a")].filter(
    part => part.offsetWidth && !part.closest(".strip")
      && part.getBoundingClientRect().right > innerWidth
  ).map(part => part.textContent);
})()"""


@pytest.mark.parametrize("width", [400, 1200])
def test_run_report_fits_narrow_and_wide_screens(width, result, truth, browser, tmp_path):
    methods = "slgaussian", "slgaussian, depth_candidates=32, min_visible=5"
    rival = [{**row, "method": methods[1]} for row in result.rows]
    failure = {"scene": "far_" * 20, "stage": "ingest", "reason": f"/{'long/' * 30}: not there"}
    page = report_one(result, truth, rival, [failure]).as_html()
    costs = [Cost(result.dataset, name, 0.5, 0.1, 0.2, 2.0, 9) for name in methods]
    times = Times({}, {"machine": "a machine " * 20}, costs)
    file = tmp_path / "report.html"
    file.write_text(
        with_times({"html": page}, times, Rows.from_rows([*result.rows, *rival]))["html"], "utf-8"
    )
    with browser.open(file.as_uri(), width) as tab:
        assert tab.evaluate(OFF_SCREEN) == []
        assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert tab.evaluate("document.querySelectorAll('#times figure').length") == 1
        assert tab.complaints == []


def test_run_report_names_the_stage_of_a_miss(result, truth):
    worst = min((r for r in leading(result) if r["iou"] is not None), key=lambda r: r["iou"])
    ious = [name for name in load_spec("attribution").columns if name.endswith("iou")]
    question = {name: worst[name] for name in ("dataset", "scene", "frame", "query")}
    row = {**question, **dict.fromkeys(ious, 0.25), "lost": "language"}
    lost = Rows.from_rows([row], "attribution")
    report = report_one(result, truth, (), (), lost)
    assert "lost by language" in Page(report.as_html()).text
    table = next(t for t in read_tables(report.as_markdown()) if t[0][0] == "Responsible stage")
    assert [line[:3] for line in table[1:]] == [["language", "1", "0.250"], ["all", "1", "0.250"]]


def test_run_report_escapes_names(result):
    odd = "<b>&|*"
    rows = [{**result.rows[0], "query": odd, "frame": "view_01", "iou": 0.1, "hit_mask": True}]
    names = f"relevancy/view_01/{odd}", f"mask/view_01/{odd}"
    pictures = result.pictures | dict.fromkeys(names, result.pictures["input/view_00"])
    mask = np.ones((104, 144), bool)
    predictions = {("slgaussian@2", "view_01", odd): mask}
    strange = replace(result, rows=rows, predictions=predictions, pictures=pictures)
    report = report_one(strange, {"view_01": {odd: mask}}, name="<script>x</script>")
    page = Page(report.as_html())
    assert page.tags.count("script") == 1 and "const large" in page.script
    assert "<script>x</script>" in page.text and odd in page.text
    (line,) = [line for line in report.as_markdown().splitlines() if "point ✓" in line]
    assert plain(line) == f"- **{odd}** (<script>x</script>, view_01): IoU 0.10, point ✓"


def test_run_report_has_pictures_without_labels(result, truth):
    rows = [row for row in result.rows if row["frame"] == "halfway"]
    bare = replace(result, rows=rows, scene_metrics={"near": 1.0, "far": 2.0})
    page = Page(report_one(bare, truth).as_html())
    assert "1 query without ground truth, not scored" in page.text
    for words in ("Scores", "The paper's tables", "best baseline", "Lowest scores"):
        assert words not in page.text
    alts = [image["alt"] for image in page.images]
    assert alts[0] == "predicted masks in halfway"
    assert any(alt.startswith("relevancy of") for alt in alts)


def test_worst_answers_are_limited_per_scene_and_query():
    def row(scene, query, iou, hit=True, frame="f"):
        hits = {"hit_mask": hit, "hit_box": hit}
        return {"scene": scene, "frame": frame, "query": query, "iou": iou, **hits}

    rows = [row("a", "near", 0.0), row("a", "lost", 0.0, False), row("a", "none", None)]
    assert [answer["query"] for answer in worst_answers(Rows.from_rows(rows), 8, 2)] == [
        "lost",
        "near",
    ]
    rows = [row("a", str(k), 0.1 * k) for k in range(6)]
    rows += [row("a", "0", 0.0, frame="g"), row("b", "q", 0.05), row("c", "q", 0.5)]
    worst = [
        (answer["scene"], answer["query"]) for answer in worst_answers(Rows.from_rows(rows), 4, 2)
    ]
    assert worst == [("a", "0"), ("b", "q"), ("a", "1"), ("c", "q")]


def test_choose_example_returns_the_scene_of_median_iou(result, truth):
    metrics = [{"iou": 0.9}, {"iou": 0.1}, {"iou": 0.5}, {}]
    scenes = [replace(make_scene(result, truth, name=str(m)), metrics=m) for m in metrics]
    assert choose_example(scenes) is scenes[2]
    assert choose_example(scenes[3:]) is scenes[3]
