import csv
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from data_specs import load_spec
from slgaussian.benchmark.pictures import encode_png
from slgaussian.benchmark.report import (
    SHOWN_QUERIES,
    file_name,
    render_report,
    with_times,
    write_predictions,
    write_samples,
)
from slgaussian.errors import InputError

MANIFEST = {"slgaussian": "0.1.0", "settings": {"replicas": 5}}


class Page(HTMLParser):
    """Collects tags, attributes and text; complains about tags that do not nest."""

    VOID = ("meta", "img", "br")

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags, self.images, self.words, self.open = [], [], [], []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag == "img":
            self.images.append(dict(attrs))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.words))


def page_of(results, manifest=MANIFEST, failures=()) -> tuple[str, Page]:
    html = render_report(results, manifest, failures)
    page = Page(html)
    assert page.open == []
    return html, page


def leading(result):
    return [row for row in result.rows if row["protocol"] == "slgaussian@1"]


def test_the_page_needs_no_network_and_no_script(result):
    html, page = page_of([result])
    assert not {"script", "link", "iframe"} & set(page.tags)
    assert "http" not in re.sub(r'src="data:[^"]*"', "", html)
    assert "url(" not in html
    assert page.images
    for image in page.images:
        assert image["src"].startswith("data:image/jpeg;base64,")
        assert image["alt"]


def test_the_page_shows_the_numbers_and_how_they_were_made(result):
    _, page = page_of([result])
    for key, digits in (("iou", 3), ("miou", 3), ("psnr", 1), ("abs_rel", 3)):
        assert f"{result.scene_metrics[key]:.{digits}f}" in page.text
    assert "Protocol slgaussian@1 (near-best" in page.text and "temperature 10.0" in page.text
    scored = sum(row["iou"] is not None for row in leading(result))
    assert f"{scored} scored queries" in page.text
    for row in result.rows:
        assert row["query"] in page.text
    assert "not understood" in page.text


def test_the_mean_gives_every_scene_one_weight(result):
    other = replace(
        result,
        scene="other",
        rows=result.rows[:1],
        scene_metrics=result.scene_metrics | {"iou": 0.0},
    )
    _, page = page_of([result, other])
    mean = re.search(r" mean (\d\.\d+)", page.text)[1]
    assert mean == f"{result.scene_metrics['iou'] / 2:.3f}"


def test_pictures_of_the_best_and_the_worst_queries_are_shown(result):
    _, page = page_of([result])
    shown = [
        i["alt"].removeprefix("relevancy of ") for i in page.images if "relevancy of" in i["alt"]
    ]
    assert len(shown) == SHOWN_QUERIES
    scores = {row["query"]: row["iou"] for row in leading(result) if row["score"] is not None}
    scores = {query: iou for query, iou in scores.items() if iou is not None}
    assert scores[shown[0]] == max(scores.values())
    assert scores[shown[-1]] == min(scores.values())


def test_only_the_last_section_depends_on_time_and_machine(result):
    slow = replace(result, times=dict.fromkeys(result.times, 9.0))
    page, again = render_report([result], MANIFEST), render_report([slow], MANIFEST)
    assert page == again
    times = {result.scene: result.times}
    whole = with_times(page, {"field": 1.25}, times, {"machine": {"cores": 64}})
    assert Page(whole).open == []
    before, _, after = whole.partition("How long it took")
    assert page.startswith(before.removesuffix("<h2>").removesuffix("<section>\n"))
    assert "<section" not in after
    assert "1.25" in after and "machine.cores" in after and result.scene in after


def test_failures_come_first(result):
    failure = {"scene": "attic", "stage": "ingest", "reason": "attic/a.png: cannot be read"}
    _, page = page_of([result], failures=[failure])
    assert page.text.index("attic/a.png: cannot be read") < page.text.index("Summary")
    _, alone = page_of([], failures=[failure])
    assert "attic/a.png" in alone.text and "Summary" not in alone.text


def test_names_are_text_and_never_markup(result):
    rows = [{**result.rows[0], "query": "<b>&", "frame": "view_01"}]
    pictures = dict(result.pictures)
    for kind in ("relevancy", "mask"):
        pictures[f"{kind}/view_01/<b>&"] = pictures[f"input/{'view_00'}"]
    odd = replace(
        result,
        scene="<script>x</script>",
        rows=rows,
        predictions={("slgaussian@1", "view_01", "<b>&"): np.ones((104, 144), bool)},
        pictures=pictures,
    )
    html, page = page_of([odd])
    assert "script" not in page.tags
    assert "<script>x</script>" in page.text and "<b>&" in page.text
    assert "&lt;b&gt;&amp;" in html


def test_a_scene_without_truth_has_pictures_and_dashes(result):
    rows = [row for row in result.rows if row["frame"] == "halfway"]
    bare = replace(result, rows=rows, scene_metrics={"near": 1.0, "far": 2.0})
    _, page = page_of([bare])
    assert "0 scored queries, 1 asked without truth" in page.text
    assert any("relevancy of" in image["alt"] for image in page.images)


def test_sample_tables_hold_the_rows(tmp_path, result):
    other = [row | {"scene": "other"} for row in result.rows]
    write_samples([result, replace(result, scene="other", rows=other)], tmp_path)
    table = pq.read_table(tmp_path / "samples.parquet")
    load_spec("samples").check_table(table, "samples.parquet")
    assert table.to_pylist()[: len(result.rows)] == result.rows
    with open(tmp_path / "samples.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * len(result.rows)
    for row, printed in zip([*result.rows, *other], rows, strict=True):
        assert printed == {k: "" if v is None else str(v) for k, v in row.items()}
    scores = pq.read_table(tmp_path / "scores.parquet")
    load_spec("scores").check_table(scores, "scores.parquet")
    first = scores.to_pylist()[0]
    assert (first["metric"], first["scenes"]) == ("iou", 2)
    assert first["value"] == pytest.approx(result.scene_metrics["iou"], abs=1e-12)
    with open(tmp_path / "scores.csv", newline="") as file:
        assert len(list(csv.DictReader(file))) == scores.num_rows


def test_an_empty_run_has_empty_tables(tmp_path):
    write_samples([], tmp_path)
    for name in ("samples", "scores"):
        table = pq.read_table(tmp_path / f"{name}.parquet")
        load_spec(name).check_table(table, f"{name}.parquet")
        assert table.num_rows == 0


def masks_of(result) -> dict[tuple[str, str, str], bytes]:
    return {key: encode_png(mask) for key, mask in result.predictions.items()}


def test_predicted_masks_can_be_read_by_any_tool(tmp_path, result):
    write_predictions(result.rows, masks_of(result), tmp_path)
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert len(files) == len(result.predictions)
    assert len(files) == sum(row["protocol"] != "threshold-free@1" for row in result.rows)
    for (protocol, frame, query), mask in result.predictions.items():
        folder = tmp_path / "slgaussian" / protocol.removesuffix("@1") / result.scene / frame
        path = folder / f"{query}.png"
        assert np.array_equal(np.asarray(Image.open(path).convert("L")) == 255, mask)


def test_same_results_give_the_same_files(tmp_path, result):
    for folder in (tmp_path / "a", tmp_path / "b"):
        write_samples([result], folder)
        write_predictions(result.rows, masks_of(result), folder)
    for path in (tmp_path / "a").rglob("*"):
        if path.is_file():
            twin = tmp_path / "b" / path.relative_to(tmp_path / "a")
            assert path.read_bytes() == twin.read_bytes()


def test_file_names_are_safe_and_differ():
    assert file_name("blue-grey sofa") == "blue-grey sofa"
    odd = [
        "../etc",
        "a/b",
        "a\\b",
        "a:b",
        "a?b",
        ".hidden",
        "hidden",
        "é",
        "",
        " x",
        "x",
        "l" * 300,
    ]
    names = [file_name(text) for text in odd]
    assert len(set(names)) == len(odd)
    for name in names:
        assert re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9._ -]{0,99}", name)


def test_an_unwritable_place_is_named(tmp_path, result):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file"):
        write_samples([result], tmp_path / "file")
