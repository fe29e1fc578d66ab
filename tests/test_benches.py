"""Benches are no part of the suite; what they say of a wrong argument is."""

import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import jinja2
import pytest

from benches.common import pages, photograph_pairs
from benches.predict import depth_error
from benches.views import built_fields, hard_views, outward, spread
from slgaussian.predict import planesweep as sweep

ROOT = Path(__file__).parents[1]
BENCHES = sorted((ROOT / "benches").rglob("*.py"))


def test_another_folder_than_data_is_one_sentence(tmp_path):
    with pytest.raises(SystemExit, match=r"DATA: nowhere is no folder; give a folder with trans"):
        photograph_pairs.photographs("nowhere")
    (tmp_path / "office").mkdir()
    for name in ("transforms.json", "pairs.json"):
        (tmp_path / "office" / name).write_text("{}")
    with pytest.raises(SystemExit) as left:
        photograph_pairs.photographs(str(tmp_path))
    assert left.value.code == (
        f"error: DATA: {tmp_path} holds no transforms.json and no pairs.json; "
        f"did you mean {tmp_path / 'office'}?"
    )
    assert photograph_pairs.photographs(str(tmp_path / "office")) == tmp_path / "office"
    with pytest.raises(SystemExit, match=f"did you mean {tmp_path}"):
        photograph_pairs.data_folder("office/pairs.json")(str(tmp_path / "office"))


def test_a_bench_ends_so_before_it_works(tmp_path):
    command = [sys.executable, "-m", "benches.language.answer_confidence", tmp_path]
    made = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert made.returncode == 1 and made.stderr.startswith("error: DATA: ")
    assert made.stderr.count("\n") == 1


@pytest.mark.parametrize("bench", BENCHES, ids=lambda file: file.stem)
def test_no_bench_takes_any_folder_as_data(bench):
    taken = re.findall(r'add_argument\(\s*"(?:--)?data"[^)]*type=Path', bench.read_text())
    assert taken == []


def test_no_bench_has_the_name_of_another_module():
    """A traceback, an editor's tab and a search show the name without its folder."""
    packages = ("slgaussian", "flows", "tasks")
    others = {file.stem for name in packages for file in (ROOT / name).rglob("*.py")}
    names = [file.stem for file in BENCHES]
    assert len(set(names)) == len(names)
    assert not others & set(names)


def module(bench):
    return ".".join(bench.relative_to(ROOT).with_suffix("").parts)


@pytest.mark.parametrize("bench", BENCHES, ids=lambda file: file.stem)
def test_what_a_bench_imports_is_there(bench):
    importlib.import_module(module(bench))


def test_commands_that_pages_and_benches_name_are_there():
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *BENCHES]
    text = " ".join(page.read_text() for page in pages)
    named = set(re.findall(r"python -m\s+(benches[\w.]*\w)", text))
    assert len(named) > 20
    assert named <= set(map(module, BENCHES))


@pytest.mark.parametrize(
    "template", sorted((ROOT / "benches").rglob("*.j2")), ids=lambda file: file.stem
)
def test_templates_of_pages_can_be_read(template):
    pages.environment().get_template(template.relative_to(ROOT / "benches").as_posix())


def test_a_page_is_what_was_measured_in_the_words_of_its_template(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(pages, "measured", lambda: "Measured today.")
    rows = [
        {
            **dict.fromkeys(("precision", "candidates"), "auto"),
            **dict.fromkeys(("load", "seconds", "cpu", "share", "peak"), 1234.5),
            **dict.fromkeys(("distance_mean", "distance_greatest", "pixel_mean"), 0.00123),
        }
    ]
    results = {"rows": rows, "weights": "weights", "command": "a command"}
    pages.publish("predict/mvsplat.md.j2", tmp_path / "new" / "mvsplat.md", **results)
    text = (tmp_path / "new" / "mvsplat.md").read_text()
    assert capsys.readouterr().out == f"{text}\n"
    assert text.startswith("# MVSplat, measured\n\nMeasured today.\n\nMade by `a command`.\n")
    last = [cell.strip() for cell in text.splitlines()[-1].split("|")[1:-1]]
    assert last == ["auto"] * 2 + ["1234.50"] * 4 + ["1,234"] + ["1.2e-3"] * 3 + [""]
    with pytest.raises(jinja2.UndefinedError, match="weights"):
        pages.page("predict/mvsplat.md.j2", rows=rows, command="a command")


def test_stages_that_the_bench_of_depth_times_are_all_and_called_where_it_looks():
    missing = [
        stage for stage, module in depth_error.STAGES.items() if not callable(vars(module)[stage])
    ]
    assert missing == []
    steps = {
        name
        for name, step in vars(sweep).items()
        if callable(step) and not inspect.isclass(step)
        if step.__module__.startswith("slgaussian.predict.") and step.__module__ != sweep.__name__
    }
    small = {"candidates", "inverse_depth_range", "visible_share", "concatenate"}
    assert steps - small == {
        stage for stage, module in depth_error.STAGES.items() if module is sweep
    }


def test_targets_of_rooms_are_apart_from_the_context_views_of_every_number():
    steps = list(range(spread.ARC + 1))
    for number in spread.NUMBERS:
        context = spread._evenly(steps, number)
        assert len(set(context)) == number and {context[0], context[-1]} == {0, spread.ARC}
        assert min(abs(a - b) for a in context for b in spread.TARGETS) >= 7


def test_windows_of_a_walk_have_all_their_frames_and_one_target():
    starts = outward.starts(31, (2, 6), 10)
    assert list(starts) == [0, 10, 20]
    assert starts[-1] + 2 * 6 - 1 == 31


def test_gains_of_more_views_are_of_the_windows_that_both_numbers_can_do():
    cost = {"gaussians": 100, "seconds": 1.0, "memory": 9.0, "ssim": 0.5}
    rows = [
        {"of": of, "views": views, "psnr": psnr, "best_two_psnr": 21.0, **cost}
        for of, views, psnr in (("a", 2, 20.0), ("b", 2, 22.0), ("a", 4, 23.0), ("c", 4, 40.0))
    ]
    rows.append({"of": "b", "views": 4, "refused": "do not overlap"})
    two, four = built_fields.summary(rows, (2, 4))
    assert (two["scenes"], two["psnr"], "gain" in two) == (2, 21.0, False)
    assert (four["scenes"], four["refused"], four["psnr"]) == (1, 1, 23.0)
    assert (four["gain"], four["worst"], four["over_best"]) == (3.0, 3.0, 2.0)
    assert built_fields.reasons(rows) == ["4 views, b: do not overlap"]


def test_a_case_is_compared_with_the_same_scenes_without_it():
    made = {"gaussians": 110, "plain_gaussians": 100, "objects": 4, "plain_objects": 4, "said": []}
    rows = [
        {"of": of, "case": "dark", "psnr": psnr, "plain_psnr": 20.0, **made}
        for of, psnr in (("a", 19.0), ("b", 20.5))
    ]
    rows.append({"of": "c", "case": "dark", "refused": "no overlap"})
    rows[0]["said"] = ["x is left out: it is the same picture as y"]
    (line,) = hard_views.summary(rows)
    assert (line["scenes"], line["refused"], line["warned"]) == (3, 1, 1)
    assert (line["gain"], line["worst"], line["objects"]) == (-0.25, -1.0, 1.0)
    assert line["gaussians"] == pytest.approx(1.1)
    assert hard_views.said(rows) == ["dark: no overlap", f"dark: {rows[0]['said'][0]}"]
