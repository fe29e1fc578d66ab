"""Printed tables of scores state their meaning and their intervals."""

import json

import pytest

from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.benchmark.outputs import write_samples
from slgaussian.benchmark.reports.terminal import scenes_text
from slgaussian.benchmark.scores import scene_means
from tests.benchmark.rows import sample


def make_result(scene, *ious, method="m", dataset="d"):
    named = {"method": method, "dataset": dataset}
    rows = [sample(scene, f"q{k}", iou=iou, **named) for k, iou in enumerate(ious)]
    other = [row | {"protocol": "langsplat@2", "iou": 0.0} for row in rows]
    metrics = scene_means(rows) | {"psnr": 20.0}
    return SceneResult(scene, rows + other, metrics, {}, {}, dataset, method)


def test_the_mean_has_an_interval_and_says_by_what():
    lines = scenes_text([make_result("a", 0.2, 0.4), make_result("b", 0.9)]).splitlines()
    assert [line.split() for line in lines[:-1]] == [
        ["Scene", "IoU", "PSNR"],
        ["a", "0.300", "20.0"],
        ["b", "0.900", "20.0"],
        ["mean", "0.600", "(0.300–0.900)", "20.0"],
    ]
    assert lines[-1] == (
        "by slgaussian@2 (near-best, share 0.7, temperature 10, phrases: lerf, absent: skip); "
        "3 samples of 2 scenes; fewer than 6 places: a rough interval"
    )


def test_one_scene_has_no_interval_and_no_scene_no_numbers():
    *_, mean, by = scenes_text([make_result("a", 0.5)]).splitlines()
    assert mean.split() == ["mean", "0.500", "20.0"]
    assert by.endswith("1 sample of 1 scene; one place: no interval")
    unasked = SceneResult("a", [], {"psnr": 20.0}, {}, {})
    assert len(scenes_text([unasked]).splitlines()) == 3
    assert scenes_text([]) == ""


def test_the_exit_status_of_a_comparison_gates_by_losses_and_absent_scenes(slg, tmp_path):
    """Three scenes lose 0.03, 0.03 and 0, by 0.02 in the mean; mIoU, which falls, is no gate."""

    def leave(name, *ious, **columns):
        rows = [
            sample(s, iou=iou, height=9, width=9, **columns)
            for s, iou in zip("abc", ious, strict=False)
        ]
        write_samples(rows, tmp_path / name)
        return tmp_path / name

    main = leave("main", 0.5, 0.6, 0.7, class_iou=0.9)
    branch, few = leave("branch", 0.47, 0.57, 0.7, class_iou=0.8), leave("few", 0.9, 0.9)
    status, printed, errors = slg("compare", main, branch, "--fail-below", "0.019", "--json")
    (row,) = (row for row in json.loads(printed) if row["decides"])
    assert status == 1 and "m lost 0.0200 iou on d (interval of the difference -0.0300" in errors
    assert row["difference"] == pytest.approx(-0.02) and (row["scenes"], row["metric"]) == (
        3,
        "iou",
    )
    assert (row["low"], row["high"]) == (pytest.approx(-0.03), pytest.approx(0))
    assert slg("compare", main, branch, "--fail-below", "0.021")[0] == 0
    assert slg("compare", branch, main, "--fail-below", "0")[0] == 0
    status, _, errors = slg("compare", main, few, "--fail-below", "0.02")
    assert status == 1 and "few: lacks 1 of 3 scenes, as c" in errors
    assert slg("compare", main, few)[0] == 0
    other = leave("other", 0.9, 0.9, 0.9, frame="g")
    status, _, errors = slg("compare", main, branch, other, "--fail-below", "1")
    assert status == 2 and "other has no scored query in common" in errors
