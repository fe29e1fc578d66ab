import math
import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from pages import Page, check_alone, tables_of

from slgaussian.benchmark import opening, report
from slgaussian.benchmark.costs import Cost
from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.benchmark.numerics import HardCase
from slgaussian.benchmark.report import Scene, render_report, with_times
from slgaussian.benchmark.scores import score_table
from slgaussian.benchmark.statistics import LEAST
from slgaussian.benchmark.timings import StageCost, Times
from slgaussian.datasets.published import RECOGNISED
from slgaussian.language.query import NEAR_BEST
from slgaussian.storage.account import Account
from slgaussian.storage.specs import load_spec

ACCOUNT = Account(12345, 6789, 0.25, 0.5, 9.5, 3, 5, 1_200_000, 300_000, 7, 40, 144)
MANIFEST = {"slgaussian": "0.1.0", "settings": {"replicas": 5}}


@pytest.fixture(scope="module")
def truth(room):
    masks = room.truth["view_01"]
    some = next(iter(masks.values()))
    return {"view_01": masks | {"qqwx": some, "red sofa": np.zeros_like(some)}}


def named(result: SceneResult, method: str) -> SceneResult:
    """The same answers, as another method's."""
    return replace(result, rows=[{**row, "method": method} for row in result.rows])


def scene_of(result: SceneResult, truth, *others: SceneResult, name: str = "") -> Scene:
    """A scene of a report; of ``others`` no pictures are asked for, as they have none."""
    name = name or result.scene
    by_method = {each.rows[0]["method"]: each for each in (result, *others) if each.rows}
    rows = [{**row, "scene": name} for each in (result, *others) for row in each.rows]
    return Scene(
        name=name,
        dataset=result.dataset,
        rows=rows,
        metrics=result.scene_metrics,
        account=ACCOUNT,
        pictures=lambda: result.pictures,
        truth=lambda: truth,
        masks=lambda method: by_method[method].predictions,
    )


@pytest.fixture(scope="module")
def both(result, truth):
    """A report of one scene, ours and a method that finds nothing."""
    nothing = {
        **dict.fromkeys(("iou", "boundary_iou", "class_iou", "average_precision"), 0.0),
        **dict.fromkeys(("hit_mask", "hit_box", "hit_peak"), False),
    }
    poor = named(result, "nearest-view")
    rows = [
        {**row, **{k: v for k, v in nothing.items() if row[k] is not None}} for row in poor.rows
    ]
    masks = {key: np.zeros_like(mask) for key, mask in result.predictions.items()}
    poor = replace(poor, rows=rows, predictions=masks)
    return render_report([scene_of(result, truth, poor)], MANIFEST)


@pytest.fixture
def page_of(truth) -> Callable[..., Page]:
    def made(results, failures=(), attribution=()) -> Page:
        scenes = [scene_of(result, truth, name=result.scene) for result in results]
        return Page(render_report(scenes, MANIFEST, failures, attribution).html)

    return made


def leading(result):
    return [row for row in result.rows if row["protocol"] == "slgaussian@2"]


def test_the_page_needs_no_network(both):
    check_alone(both.html)
    assert Page(both.html).images and "svg" in Page(both.html).tags


def test_the_page_shows_the_numbers_and_how_they_were_made(result, page_of):
    page = page_of([result])
    for key, digits in (("iou", 3), ("miou", 3), ("psnr", 1), ("abs_rel", 3)):
        assert f"{result.scene_metrics[key]:.{digits}f}" in page.text
    rule = f"slgaussian@2 near-best, share {NEAR_BEST}"
    assert f"{rule}, temperature 10, phrases: encoder's" in page.text
    scored = sum(row["iou"] is not None for row in leading(result))
    assert f"{scored} scored queries" in page.text
    for row in result.rows:
        assert row["query"] in page.text
    assert "not understood" in page.text
    assert f"n {scored}" in page.text


def test_both_forms_say_the_same_numbers(both, result):
    scores = {
        (row["method"], row["metric"]): row["value"]
        for row in score_table(result.rows).to_pylist()
        if row["protocol"] == "slgaussian@2"
    }
    table = next(t for t in tables_of(both.markdown) if t[0][0] == "Method")
    line = next(line for line in table if line[0] == "slgaussian")
    column = table[0].index("IoU")
    assert line[column] == f"**{scores['slgaussian', 'iou']:.3f}**"
    assert table[1][column] == "slgaussian@2"
    text = Page(both.html).text
    for cells in table[1:]:
        for cell in cells[1:]:
            for number in re.findall(r"[\d.]+", cell):
                assert number in text
    gains = next(t for t in tables_of(both.markdown) if t[0][0] == "Minus")
    assert gains[-1][:2] == ["nearest-view", f"{scores['slgaussian', 'iou']:+.3f}"]
    assert gains[-1][1] in text
    assert "not LangSplat" not in text and "the nearest photograph's masks" in text


def test_what_may_be_claimed_is_said_by_rule(result, truth, both):
    """Of one scene nothing; of six the same gain is beyond noise, in both forms alike."""
    told = "too few places to tell from nearest-view: +"
    for page in (both.html, both.markdown):
        assert told in page and "ahead of" not in page
    worse = named(result, "nearest-view")
    rows = [row | {"iou": row["iou"] and row["iou"] / 2} for row in worse.rows]
    worse = replace(worse, rows=rows)
    scenes = [scene_of(result, truth, worse, name=f"scene {k}") for k in range(LEAST)]
    page = render_report(scenes, MANIFEST)
    text = f"ahead of nearest-view by {result.scene_metrics['iou'] / 2:+.3f} ("
    assert f'<li class="better">{text}' in page.html
    assert f"- {text}" in page.markdown and "too few places" not in page.markdown


def test_the_papers_tables_name_what_ran_beside_what_it_is_like(both, result, truth):
    assert "The paper's tables" not in both.html + both.markdown  # none of its scenes ran
    known = {"standing": RECOGNISED, "format": "lerf_ovs", "scene": "teatime"}
    data = {"data": {result.scene: {"published": known}}}
    both = render_report([scene_of(result, truth)], MANIFEST | data)
    table = next(t for t in tables_of(both.markdown) if "LangSplat" in " ".join(t[0]))
    assert table[0][1:4] == [
        "IoU (%): LERF / lerf-like",
        "IoU (%): LangSplat / langsplat-like",
        "IoU (%): SLGaussian / slgaussian",
    ]
    heads = set(re.findall(r"<th>(LangSplat.*?)</th>", both.html))
    assert heads == {"LangSplat<small>langsplat-like</small>"}
    assert "<td>2D Query<small>query-2d</small></td>" in both.html


def asked_in(html: str) -> list[str]:
    """Which queries have a picture of their relevancy, in order."""
    return re.findall(r'alt="relevancy of ([^"]*)"', html)


def test_pictures_come_first_then_one_table_then_what_failed(both, result):
    scores = {row["query"]: row["iou"] for row in leading(result) if row["iou"] is not None}
    text = Page(both.html).text
    order = ["How good, by method", "Methods, ", "Answered worst", "The same query", "What ran"]
    places = [text.rindex(words) for words in order]
    assert places == sorted(places)
    opening, _, rest = both.html.partition("<table")
    # The pictures that open the page go from the best answer to the worst.
    shown = [scores[query] for query in asked_in(opening)]
    assert shown[0] == max(scores.values()) and shown[-1] == min(scores.values())
    assert shown == sorted(shown, reverse=True) and len(shown) == 4
    for alt in ("given photograph view_00", "photograph view_01, never shown", "everything found"):
        assert f'alt="{alt}' in opening
    lowest = asked_in(rest.partition("Answered worst")[2])
    assert scores[lowest[0]] == min(scores.values())


def test_the_first_lines_say_how_good_on_what_and_compared_with_what(both, result):
    lines, _, _ = Page(both.html).text.partition("What these numbers mean")
    scores = {s["metric"]: s for s in score_table(leading(result)).to_pylist()}
    asked = scores["iou"]["samples"]
    assert f"It was asked for {asked} things" in lines and "1 other method (nearest-view)" in lines
    assert f"IoU, 0 to 1 {scores['iou']['value']:.2f} best other: 0.00, nearest-view" in lines
    assert f"{100 * scores['hit_mask']['value']:.0f} % best other: 0 %, nearest-view" in lines
    assert f"{result.scene_metrics['psnr']:.1f} dB" in lines


def test_a_variant_of_ours_is_no_other_method():
    assert opening.compared([]) == ""
    assert opening.compared(["no-bank"]) == "1 variant (no-bank)"
    assert (
        opening.compared(["query-2d", "no-bank", "query-2d, depth"])
        == "2 other methods (query-2d; query-2d, depth) and 1 variant (no-bank)"
    )
    assert opening.compared([*map(str, range(5)), "absent-zero"]) == "5 other methods and 1 variant"

    def iou(method: str, value: float) -> dict[str, object]:
        return {"method": method, "metric": "iou", "value": value, "low": None, "high": None}

    ours, best, other = iou("slgaussian", 0.5), iou("no-bank", 0.6), iou("query-2d", 0.4)
    for rows, said in (
        ([ours, best, other], "best other: 0.40, query-2d"),
        ([ours, best], "best variant: 0.60, no-bank"),
        ([ours], ""),
    ):
        (number, *_) = opening.key_numbers("office", rows, [], "slgaussian")
        assert number.other == said


def test_terms_are_explained_before_they_are_used(both):
    page = both.html
    table = page.index('<table class="scores main">')
    for term in ("IoU", "Point in mask", "mIoU", "near-best", "memory"):
        assert page.index(f"<b>{term}</b>") < table
    cards = page.partition("Answered worst")[2]
    assert cards.index("<b>relevancy</b>") < cards.index('class="card"')


def test_without_labels_nothing_is_scored_above_the_pictures_nor_below(result, page_of):
    rows = [row for row in result.rows if row["frame"] == "halfway"]
    bare = replace(result, rows=rows, scene_metrics={"near": 1.0, "far": 2.0})
    page = page_of([bare])
    assert "without labels nothing is scored" in page.text
    for words in ("How good", "The paper's tables", "overlap with the truth", "IoU"):
        assert words not in page.text.partition("Scene by scene")[0]
    alts = [image["alt"] for image in page.images]
    assert alts[0].startswith("everything found in halfway")


def test_the_scene_that_opens_the_page_is_the_middle_one():
    found = opening.choose_scenes(
        [(f"s{k}", "a", {"iou": iou}) for k, iou in enumerate((0.9, 0.1, 0.5))]
        + [("t0", "b", {}), ("t1", "b", {})]
    )
    assert found == {
        "s2": "in the middle of the 3 scenes of a",
        "t0": "the first of the 2 scenes of b",
    }


def test_the_worst_answers_are_listed_worst_first(both, result):
    scores = {row["query"]: row["iou"] for row in leading(result) if row["iou"] is not None}
    table = next(t for t in tables_of(both.markdown) if t[0][0] == "Query")
    ious = [float(row[3]) for row in table[1:]]
    assert ious == sorted(ious) and ious[0] == pytest.approx(min(scores.values()), abs=1e-3)
    assert table[1][6].startswith("predictions/slgaussian/slgaussian/")


def test_every_method_answers_the_same_query(both, result):
    alts = [image["alt"] for image in Page(both.html).images]
    ours = [alt for alt in alts if alt.endswith(" by slgaussian")]
    theirs = [alt for alt in alts if alt.endswith(" by nearest-view")]
    assert 0 < len(ours) == len(theirs) <= 5


def test_the_mean_gives_every_scene_one_weight(result, page_of):
    other = replace(
        result,
        scene="other",
        rows=result.rows[:1],
        scene_metrics=result.scene_metrics | {"iou": 0.0},
    )
    mean = re.search(r" mean (\d\.\d+)", page_of([result, other]).text)[1]
    assert mean == f"{result.scene_metrics['iou'] / 2:.3f}"


def test_scenes_of_different_data_sets_are_not_averaged(result, truth):
    other = replace(result, scene_metrics=result.scene_metrics | {"iou": 0.0}, dataset="attic")
    scenes = [scene_of(result, truth), scene_of(other, truth, name="other")]
    means = re.findall(r" mean (\d\.\d+)", Page(render_report(scenes, MANIFEST).html).text)
    assert means == [f"{result.scene_metrics['iou']:.3f}", "0.000"]


def test_only_one_section_and_marked_numbers_depend_on_time_and_machine(both, result):
    good = HardCase("rasteriser", "needles", "long", "of alpha", 2e-7, 5e-6)
    times = Times(
        {"field": StageCost(1.25, 0.75, 64_000_000, 30.0), "masks": StageCost(3.75, 1.5)},
        [
            ("slgaussian", "room", {"cold_query": 3.5, "first_query": 0.5}),
            ("query-2d", "room", {"prepare": 2.0, "first_query": 6.0}),
        ],
        {"machine": "a machine", "processor": "this"},
        {"this": 5, "another machine": 12},
        hard_cases=[good, replace(good, case="on its edge", error=math.nan)],
    )
    whole = with_times(both, times)
    assert with_times(both, times) == whole
    Page(whole.html)
    cost = Cost(result.dataset, "slgaussian", None, 0.1234, None, None, 12.3, 8_000_000, 9)
    costly = with_times(both, replace(times, costs=[cost]))
    for text in ("0.12</span> s", "12</span> s", '<td><span class="took">8</span></td>'):
        assert text in costly.html
    took = r'<span class="took">[^<]*</span>'
    for form in ("html", "markdown"):
        unfilled = re.sub(r"<!-- \w+ [0-9a-f]+ [0-9a-f]+ -->", "", getattr(both, form))
        before, after = unfilled.split(report.TIMES_HERE)
        page = re.sub(took, "", getattr(whole, form))
        assert page.startswith(before) and page.endswith(after)
        own = page[len(before) : len(page) - len(after)]
        claim = "6 s against 0.5 s; the paper says 18 s against 0.011 s"
        for words in ("1.25", "0.5000", "2.0000", "a machine", "12 times as long", claim):
            assert words in own
    assert 'href="#times"' in whole.html and 'id="times"' in whole.html
    stages = next(t for t in tables_of(whole.markdown) if t[0][0] == "Stage")
    assert stages[1:] == [
        ["field", "0.75", "1.25", "25 %", "64"],
        ["masks", "1.50", "3.75", "75 %", "–"],
    ]
    text = Page(whole.html).text
    assert "Compiling kernels, once an installation, took 30 s more" in text
    assert "On this, 1 of 2 are beyond their bounds : on its edge (rasteriser)." in text
    hard = next(t for t in tables_of(whole.markdown) if "Hard case" in t[0])
    assert [line[-1] for line in hard[1:]] == ["ok", "beyond"]
    speeds = next(
        t for t in tables_of(whole.markdown) if any("First query" in head for head in t[0])
    )
    assert speeds[1:] == [
        ["slgaussian", "–", "3.5000", "0.5000", "–", "0.011"],
        ["query-2d", "2.0000", "–", "6.0000", "–", "18"],
    ]
    assert "12 on another machine: their seconds" in Page(whole.html).text


def test_what_methods_get_right_is_set_against_what_they_cost(both, result):
    costs = [
        Cost(result.dataset, method, None, seconds, None, None, None, held, held)
        for method, seconds, held in (
            ("slgaussian", 0.5, 300_000_000),
            ("nearest-view", 0.1, 500_000_000),
        )
    ]
    times = Times({}, [], {}, costs=costs)
    rows = [*result.rows, *({**row, "iou": 0.0} for row in named(result, "nearest-view").rows)]
    whole = with_times(both, times, rows)
    own = next(t for t in tables_of(whole.markdown) if t[0][-1] == "Front")
    assert [line[0] for line in own[1:]] == ["slgaussian", "nearest-view"]
    assert own[1][1] == f"{result.scene_metrics['iou']:.3f}" and own[2][1] == "0.000"
    assert [line[-3:] for line in own[1:]] == [
        ["0.5000", "300", "time, memory"],
        ["0.1000", "500", "time"],
    ]
    height, width = result.rows[0]["height"], result.rows[0]["width"]
    text = Page(whole.html).text
    assert f"judged at {height} x {width} pixels (height x width)" in text
    assert whole.html.count("<svg") == both.html.count("<svg") + 2
    check_alone(whole.html)


def test_left_out_scenes_come_before_everything(result, page_of):
    failures = [
        {"scene": f"attic {k}", "stage": "ingest", "reason": "a.png: cannot be read"}
        for k in range(5)
    ]
    text = page_of([result], failures).text
    assert text.index("a.png: cannot be read") < text.index("Answered worst")
    assert "attic 0; attic 1; attic 2; and 2 more" in text and "5 left out" in text
    alone = page_of([], failures)
    assert "a.png" in alone.text and "Scene by scene" not in alone.text


def test_what_lost_a_query_is_said_beside_it(result, page_of):
    worst = min((r for r in leading(result) if r["iou"] is not None), key=lambda r: r["iou"])
    ious = [name for name in load_spec("attribution").columns if name.endswith("iou")]
    assert ious == list(report.STAND_INS)
    asked = {name: worst[name] for name in ("dataset", "scene", "frame", "query")}
    row = {**asked, **dict.fromkeys(ious, 0.25), "geometry_iou": None, "lost": "language"}
    text = page_of([result], attribution=[row]).text
    assert "lost by language" in text
    assert re.search(r"lost by .* language 1 0\.250 .* all 1 0\.250", text)


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
    made = render_report([scene], MANIFEST)
    page = Page(made.html)
    assert page.tags.count("script") == 1 and "const large" in page.script
    assert "<script>x</script>" in page.text and odd in page.text
    table = next(t for t in tables_of(made.markdown) if t[0][0] == "Query")
    assert table[1][:2] == [odd, "<script>x</script>"]


def test_a_scene_without_truth_has_pictures_and_dashes(result, page_of):
    rows = [row for row in result.rows if row["frame"] == "halfway"]
    bare = replace(result, rows=rows, scene_metrics={"near": 1.0, "far": 2.0})
    page = page_of([bare])
    assert "0 scored queries, 1 asked without truth" in page.text
    assert any("relevancy of" in image["alt"] for image in page.images)
    assert "Answered worst" not in page.text


def test_of_many_scenes_the_worst_are_drawn_and_all_are_told(result, truth, monkeypatch):
    monkeypatch.setattr(report, "FEW", 1)
    monkeypatch.setattr(report, "MOST", 2)
    read: list[str] = []

    def scene(k: int) -> Scene:
        name = f"scene {k}"
        own = replace(result, scene_metrics=result.scene_metrics | {"iou": k / 20})
        made = scene_of(own, truth, name=name)
        return replace(made, pictures=lambda: read.append(name) or result.pictures)

    page = Page(render_report([scene(k) for k in range(20)], MANIFEST).html)
    inputs = [image for image in page.images if image["alt"] == "view_00"]
    assert len(inputs) == 2
    # A scene's pictures are read once, and not at all where none of them is shown.
    assert len(read) == len(set(read)) < 20
    for k in range(20):
        assert f"scene {k}" in page.text


def test_the_same_results_give_the_same_bytes(both, result, truth):
    scene = scene_of(result, truth)
    assert render_report([scene], MANIFEST) == render_report([scene], MANIFEST)


def test_what_each_field_is_made_of_is_told(result, truth):
    made = render_report([scene_of(result, truth)], MANIFEST)
    line = "12,345 | 6,789 | 55% | 0.25 | 0.50 | 9.50 | 40 | 144 | 3 | 7 | 5 | 1.2 | 0.3 |"
    assert line in made.markdown
    told = next(table for table in tables_of(made.markdown) if "Gaussians made" in table[0])
    assert told[1][1:] == line.removesuffix(" |").split(" | ")
    assert "".join(f"<td>{cell}</td>" for cell in told[1][1:]) in made.html
