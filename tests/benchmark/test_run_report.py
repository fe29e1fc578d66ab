"""The report of a run: what it shows, in which order, in both forms."""

import re
from dataclasses import replace

import numpy as np
import pytest
from pages import Page, check_alone, tables_of

from slgaussian.benchmark.costs import Cost, Times
from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.benchmark.reports import run_report
from slgaussian.benchmark.reports.model import Report
from slgaussian.benchmark.reports.run_report import with_times
from slgaussian.benchmark.reports.scenes import Scene
from slgaussian.benchmark.reports.summary import compared, key_numbers
from slgaussian.benchmark.scores import score_table
from slgaussian.benchmark.statistics import LEAST
from slgaussian.datasets.published import RECOGNISED
from slgaussian.language.query import NEAR_BEST
from slgaussian.storage.specs import load_spec

MANIFEST = {"slgaussian": "0.1.0", "settings": {"replicas": 5}}


@pytest.fixture(scope="module")
def truth(room):
    masks = room.truth["view_01"]
    some = next(iter(masks.values()))
    return {"view_01": masks | {"qqwx": some, "red sofa": np.zeros_like(some)}}


def scene_of(result: SceneResult, truth, *others, name: str = "") -> Scene:
    """A scene of a report, with rows of other methods."""
    name = name or result.scene
    rows = [{**row, "scene": name} for own in (result.rows, *others) for row in own]
    return Scene(
        name=name,
        dataset=result.dataset,
        rows=rows,
        metrics=result.scene_metrics,
        pictures=lambda: result.pictures,
        truth=lambda: truth,
        masks=lambda: result.predictions,
    )


def half_as_good(result) -> list[dict]:
    """Rows of another method, every score of it half as high."""
    names = ("iou", "boundary_iou", "class_iou", "average_precision")
    halves = [{k: row[k] / 2 for k in names if row[k] is not None} for row in result.rows]
    named = {"method": "query-2d"}
    return [{**row, **half, **named} for row, half in zip(result.rows, halves, strict=True)]


@pytest.fixture(scope="module")
def both(result, truth) -> Report:
    """The report of one scene by two methods."""
    return run_report.run_report([scene_of(result, truth, half_as_good(result))], MANIFEST)


@pytest.fixture(scope="module")
def page(both) -> Page:
    return Page(both.as_html())


def leading(result):
    return [row for row in result.rows if row["protocol"] == "slgaussian@2"]


def test_the_page_stands_alone_with_the_same_bytes(both, result, truth):
    check_alone(both.as_html())
    again = run_report.run_report([scene_of(result, truth, half_as_good(result))], MANIFEST)
    assert (again.as_html(), again.as_markdown()) == (both.as_html(), both.as_markdown())


def test_both_forms_have_the_numbers_and_their_conditions(both, page, result):
    scores = {s["metric"]: s for s in score_table(leading(result)).to_pylist()}
    value = f"{scores['iou']['value']:.3f}"
    tables = tables_of(both.as_markdown())
    table = next(t for t in tables if t[0][0] == "Method")
    asked = scores["iou"]["samples"]
    assert table[0][1] == f"slgaussian@2: IoU / n {asked}"
    assert [row[:2] for row in table[1:3]] == [
        ["slgaussian", f"**{value}**"],
        ["query-2d", f"{scores['iou']['value'] / 2:.3f}"],
    ]
    gain = f"{scores['iou']['value'] / 2:+.3f} (too few places to tell)"
    assert table[0][-1] == "slgaussian minus it"
    assert [row[-1] for row in table[1:3]] == ["–", gain]
    for cells in table[1:3]:
        for number in re.findall(r"[\d.]+", " ".join(cells)):
            assert number in page.text
    rule = f"slgaussian@2: near-best, share {NEAR_BEST}, temperature 10, phrases: encoder's"
    assert rule in page.text
    for key, digits in (("psnr", 1), ("abs_rel", 3)):
        assert f"{result.scene_metrics[key]:.{digits}f}" in page.text


def test_the_first_lines_say_how_good_on_what_and_compared_with_what(page, result):
    lines, _, _ = page.text.partition("What these numbers mean")
    scores = {s["metric"]: s for s in score_table(leading(result)).to_pylist()}
    iou, asked = scores["iou"]["value"], scores["iou"]["samples"]
    assert f"It was asked for {asked} things" in lines and "1 other method (query-2d)" in lines
    assert f"IoU, 0 to 1 {iou:.2f} best other: {iou / 2:.2f}, query-2d" in lines
    assert f"{result.scene_metrics['psnr']:.1f} dB" in lines
    assert f"{asked} scored queries" in lines and "1 not understood" in lines


def test_a_variant_of_ours_is_no_other_method():
    assert compared([]) == ""
    assert compared(["no-bank"]) == "1 variant (no-bank)"
    assert (
        compared(["query-2d", "no-bank", "lerf-like"])
        == "2 other methods (query-2d; lerf-like) and 1 variant (no-bank)"
    )
    assert compared([*map(str, range(5)), "no-bank"]) == "5 other methods and 1 variant"


def test_the_best_other_stands_beside_a_number_and_a_variant_only_without_one(result, truth):
    def iou(method: str, value: float) -> dict[str, object]:
        score = {"method": method, "metric": "iou", "value": value, "low": None, "high": None}
        return score | {"dataset": result.dataset}

    ours, best, other = iou("slgaussian", 0.5), iou("no-bank", 0.6), iou("query-2d", 0.4)
    for scores, said in (
        ([ours, best, other], "best other: 0.40, query-2d"),
        ([ours, best], "best variant: 0.60, no-bank"),
        ([ours], ""),
    ):
        numbers = key_numbers([scene_of(result, truth)], scores, "slgaussian")
        assert next(iter(numbers.values()))[0][3] == said


def test_pictures_come_first_then_scores_then_the_rest(page, result):
    order = ["found by its words", "How good, by method", "Every score", "Speed against error",
             "Answered worst", "Scene by scene", "objects, depth and", "What ran"]  # fmt: skip
    places = [page.text.rindex(words) for words in order]
    assert places == sorted(places)
    scores = {row["query"]: row["iou"] for row in leading(result) if row["iou"] is not None}
    alts = [image["alt"] for image in page.images]
    asked = [alt.removeprefix("relevancy of ") for alt in alts if alt.startswith("relevancy of")]
    opening, lowest = [scores[query] for query in asked[:4]], scores[asked[4]]
    assert opening == sorted(opening, reverse=True)
    assert opening[0] == max(scores.values()) and lowest == min(scores.values())
    for alt in ("everything found", "given photograph view_00", "photograph view_01, never shown"):
        assert any(own.startswith(alt) for own in alts[:14])


def test_a_method_is_ahead_only_beyond_noise(both, result, truth):
    text = "too few places to tell"
    assert text in both.as_html() and text in both.as_markdown()
    other = half_as_good(result)
    scenes = [scene_of(result, truth, other, name=f"scene {k}") for k in range(LEAST)]
    report = run_report.run_report(scenes, MANIFEST)
    half = f"{result.scene_metrics['iou'] / 2:+.3f}"
    assert '<td class="better" title=' in report.as_html()
    assert f"{half}<small>{half} to {half}, ahead</small>" in report.as_html()
    assert f"{half} ({half} to {half}, ahead) better" in report.as_markdown()


def test_the_papers_tables_stand_only_where_one_of_its_scenes_ran(both, result, truth):
    assert "The paper's tables" not in both.as_html() + both.as_markdown()
    standing = {"standing": RECOGNISED, "format": "lerf_ovs", "scene": "teatime"}
    data = {"data": {result.scene: {"published": standing}}}
    report = run_report.run_report([scene_of(result, truth)], MANIFEST | data)
    table = next(t for t in tables_of(report.as_markdown()) if "LangSplat" in " ".join(t[0]))
    assert table[0][2] == "IoU (%): LangSplat / langsplat-like"
    assert "LangSplat<small>langsplat-like</small>" in report.as_html()


def test_the_mean_gives_every_scene_of_a_data_set_one_weight(result, truth):
    zero = result.scene_metrics | {"iou": 0.0}
    iou = result.scene_metrics["iou"]
    for dataset, expected in ((result.dataset, [iou / 2]), ("attic", [iou, 0.0])):
        other = replace(result, scene_metrics=zero, dataset=dataset, rows=result.rows[:1])
        scenes = [scene_of(result, truth), scene_of(other, truth, name="other")]
        tables = tables_of(run_report.run_report(scenes, MANIFEST).as_markdown())
        means = [line[1] for t in tables if t[0][0] == "scene" for line in t if line[0] == "mean"]
        assert [mean.partition(" ")[0] for mean in means] == [f"{one:.3f}" for one in expected]


def test_seconds_are_filled_in_afterwards(both, result):
    pages = {"html": both.as_html(), "markdown": both.as_markdown()}
    cost = Cost(result.dataset, "slgaussian", view_query=0.1234, build=12.3)
    whole = with_times(pages, Times({}, {"machine": "a machine"}, costs=[cost]))
    for text in ("0.12</span> s", "12</span> s", "a machine"):
        assert text in whole["html"]
    for form, page in whole.items():
        before, after = re.sub(r"<!-- \w+ [0-9a-f]+ [0-9a-f]+ -->", "", pages[form]).split(
            run_report.TIMES
        )
        bare = re.sub(r'<span class="took">[^<]*</span>', "", page)
        assert bare.startswith(before) and bare.endswith(after)
        Page(page)


def test_scenes_left_out_come_before_the_worst_answers(result, truth):
    failures = [
        {"scene": f"attic {k}", "stage": "ingest", "reason": "a.png: cannot be read"}
        for k in range(5)
    ]
    text = Page(run_report.run_report([scene_of(result, truth)], MANIFEST, failures).as_html()).text
    assert text.index("a.png: cannot be read") < text.index("Answered worst")
    assert "attic 0; attic 1; attic 2; and 2 more" in text and "5 left out" in text
    alone = Page(run_report.run_report([], MANIFEST, failures).as_html()).text
    assert "a.png" in alone and "Scene by scene" not in alone


def test_the_stage_that_lost_a_query_is_named_beside_it(result, truth):
    worst = min((r for r in leading(result) if r["iou"] is not None), key=lambda r: r["iou"])
    ious = [name for name in load_spec("attribution").columns if name.endswith("iou")]
    asked = {name: worst[name] for name in ("dataset", "scene", "frame", "query")}
    row = {**asked, **dict.fromkeys(ious, 0.25), "geometry_iou": None, "lost": "language"}
    report = run_report.run_report([scene_of(result, truth)], MANIFEST, (), [row])
    assert "lost by language" in Page(report.as_html()).text
    table = next(t for t in tables_of(report.as_markdown()) if t[0][0] == "lost by")
    assert [line[:3] for line in table[1:]] == [["language", "1", "0.250"], ["all", "1", "0.250"]]


def test_names_are_text_and_never_markup(result):
    odd = "<b>&|*"
    rows = [{**result.rows[0], "query": odd, "frame": "view_01", "iou": 0.1, "hit_mask": True}]
    pictures = dict(result.pictures)
    for kind in ("relevancy", "mask"):
        pictures[f"{kind}/view_01/{odd}"] = pictures["input/view_00"]
    mask = np.ones((104, 144), bool)
    predictions = {("slgaussian@2", "view_01", odd): mask}
    strange = replace(result, rows=rows, predictions=predictions, pictures=pictures)
    scene = scene_of(strange, {"view_01": {odd: mask}}, name="<script>x</script>")
    report = run_report.run_report([scene], MANIFEST)
    page = Page(report.as_html())
    assert page.tags.count("script") == 1 and "const large" in page.script
    assert "<script>x</script>" in page.text and odd in page.text
    table = next(t for t in tables_of(report.as_markdown()) if t[0][0] == "Query")
    assert table[1][:2] == [odd, "<script>x</script>, view_01"]


def test_without_labels_there_are_pictures_and_no_scores(result, truth):
    rows = [row for row in result.rows if row["frame"] == "halfway"]
    bare = replace(result, rows=rows, scene_metrics={"near": 1.0, "far": 2.0})
    page = Page(run_report.run_report([scene_of(bare, truth)], MANIFEST).as_html())
    assert "without labels nothing is scored" in page.text
    assert "1 asked without truth" in page.text
    for words in ("How good", "The paper's tables", "overlap with the truth", "Answered worst"):
        assert words not in page.text
    alts = [image["alt"] for image in page.images]
    assert alts[0].startswith("everything found in halfway")
    assert any(alt.startswith("relevancy of") for alt in alts)


def test_of_many_scenes_the_worst_are_drawn_and_all_are_listed(result, truth, monkeypatch):
    monkeypatch.setattr(run_report, "MOST", 2)
    read: list[str] = []

    def scene(k: int) -> Scene:
        name = f"scene {k}"
        own = replace(result, scene_metrics=result.scene_metrics | {"iou": k / 20})
        shown = scene_of(own, truth, name=name)
        return replace(shown, pictures=lambda: read.append(name) or result.pictures)

    page = Page(run_report.run_report([scene(k) for k in range(20)], MANIFEST).as_html())
    inputs = [image for image in page.images if image["alt"] == "view_00"]
    assert len(inputs) == 2
    # A scene's pictures are read once, and not at all where none of them is shown.
    assert len(read) == len(set(read)) < 20
    for k in range(20):
        assert f"scene {k}" in page.text
