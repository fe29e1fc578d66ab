"""Printed tables of scores state their meaning and their intervals."""

from flows.cli.score_tables import scenes_text
from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.benchmark.scores import scene_means
from tests.benchmark.rows import sample


def result_of(scene, *ious, method="m", dataset="d"):
    named = {"method": method, "dataset": dataset}
    rows = [sample(scene, f"q{k}", iou=iou, **named) for k, iou in enumerate(ious)]
    other = [row | {"protocol": "langsplat@2", "iou": 0.0} for row in rows]
    metrics = scene_means(rows) | {"psnr": 20.0}
    return SceneResult(scene, rows + other, metrics, {}, {}, dataset, method)


def test_the_mean_has_an_interval_and_says_by_what():
    lines = scenes_text([result_of("a", 0.2, 0.4), result_of("b", 0.9)]).splitlines()
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
    *_, mean, by = scenes_text([result_of("a", 0.5)]).splitlines()
    assert mean.split() == ["mean", "0.500", "20.0"]
    assert by.endswith("1 sample of 1 scene; one place: no interval")
    unasked = SceneResult("a", [], {"psnr": 20.0}, {}, {})
    assert len(scenes_text([unasked]).splitlines()) == 3
    assert scenes_text([]) == ""
