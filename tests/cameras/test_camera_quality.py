"""Measures of scene quality against known geometry, and the verdicts drawn from them."""

from dataclasses import replace

import numpy as np
import pytest

from slgaussian import datasets
from slgaussian.build import predict
from slgaussian.cameras.check import check_pairs
from slgaussian.cameras.quality import Quality, camera_doubt, measure
from slgaussian.geometry import SceneGeometry, SeenView
from slgaussian.predict import load_predictor
from slgaussian.scene import Camera, Sample, View
from tests.cameras.walls import FAR, two_rows

GOOD = Quality(0.7, 0.6, 12.0, 15.0, 200, 0.9, 7.1, True)


@pytest.fixture(scope="module")
def room() -> Sample:
    scene = datasets.load("procedural", seed=1, views=2, height=156, width=216)
    return scene.sample(list(scene.cameras))


def measure_quality(sample: Sample, depths: np.ndarray) -> Quality:
    geometry = SceneGeometry(tuple(map(SeenView, sample.context, depths)))
    return measure(geometry, check_pairs(sample))[0]


def test_true_depth_is_confirmed_and_wrong_or_missing_depth_is_not(room):
    depths = np.stack([view.depth for view in room.context])
    good = measure_quality(room, depths)
    assert good.camera_confidence(0.95) > 0.95
    assert 0.7 < good.overlap < 1 and 0.8 * good.overlap < good.confirmed <= 1
    assert good.clash < 0.1 and good.verdict().level == "good"
    wrong = depths.copy()
    wrong[1] *= 1.1
    poor = measure_quality(room, wrong)
    assert poor.confirmed < 0.1 and poor.verdict().level == "poor"
    half = depths.copy()
    half[0, :, :108] = 0  # Transparent pixels are not counted, and confirm none of the other view.
    partial = measure_quality(room, half)
    assert partial.overlap > 0.7 and partial.confirmed < good.confirmed


def test_overlap_of_a_plane_matches_its_disparity(room):
    """At depth 2 and a baseline of 0.5, f b / Z = 25 of 100 columns fall outside."""
    K, right = np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]]), np.eye(4)
    right[0, 3] = 0.5
    blank, depth = np.zeros((80, 100, 3), np.uint8), np.full((80, 100), 2.0, np.float32)
    views = [
        View(view.name, Camera(K, c2w, 100, 80), blank)
        for view, c2w in zip(room.context, (np.eye(4), right), strict=True)
    ]
    geometry = SceneGeometry(tuple(SeenView(view, depth) for view in views))
    checks = check_pairs(room)
    quality, confirmed = measure(geometry, checks)
    assert confirmed[0, :, 25:].all() and not confirmed[0, :, :25].any()
    assert quality.overlap == pytest.approx(0.75, abs=0.011)
    assert quality.confirmed == pytest.approx(0.75, abs=0.011) and quality.turn == 0


def test_views_are_judged_by_those_they_overlap_rather_than_the_nearest():
    depths = np.full((6, 80, 240), FAR, np.float32)
    quality = measure_quality(two_rows(), depths)
    assert quality.judged and quality.explained > 0.9 and quality.matches > 200
    assert quality.angle == pytest.approx(10.6, abs=0.5) and quality.turn == 0
    assert quality.overlap == pytest.approx(0.5, abs=0.01) and quality.apart == 0
    assert quality.confirmed == pytest.approx(4 / 6, abs=0.01)  # half at the ends, all between
    assert quality.verdict().level == "good"
    depths[[0, 5]] = FAR / 3  # so near that they project outside of all other views
    quality = measure_quality(two_rows(), depths)
    assert quality.overlap == pytest.approx(0.5, abs=0.01) and quality.apart == 2
    assert quality.verdict().level != "good"


def test_summary_and_verdict():
    assert GOOD.summary() == (
        "quality: views overlap by 70%, lines of sight 12 degrees apart; the cameras explain 90% "
        "of 200 matches within 7.1 pixels; another view confirms 60% of the pixels"
    )
    assert GOOD.verdict().sentence() == "scene: good" and Quality(**GOOD.as_json()) == GOOD
    for changes, level, reason in (
        ({"angle": 48.0, "agreement": 0.6}, "usable", "48 degrees"),
        ({"turn": 48.0, "agreement": 0.6}, "usable", "turned by 48 degrees"),
        ({"overlap": 0.12}, "poor", "shares 12%"),
        ({"apart": 2}, "usable", "any other: 2"),
        ({"agreement": 0.2}, "poor", "blank or looks alike"),
        ({"agreement": 0.5, "clash": 0.35}, "poor", "something moved"),
    ):
        verdict = replace(GOOD, **changes).verdict()
        assert verdict.level == level and reason in verdict.reason
    unjudged = replace(GOOD, judged=False, angle=None)
    assert "too few agree" in unjudged.summary() and "as given" in unjudged.verdict().sentence()


def test_confidence_of_estimated_cameras_falls_with_clashes_and_doubtful_matches():
    clashes, matches = (0.0, 0.1, 0.3, 0.7), (1.0, 0.9, 0.5, 0.0)
    table = np.array(
        [[replace(GOOD, clash=c).camera_confidence(m) for m in matches] for c in clashes]
    )
    assert (np.diff(table, axis=0) < 0).all() and (np.diff(table, axis=1) < 0).all()
    assert 0.97 < table[0, 0] < 1 and 0 < table[-1, -1] < 0.02
    assert camera_doubt({"confidence": 0.97, "doubt": ""}) == camera_doubt({}) == ""
    doubted = {"confidence": 0.97, "doubt": "few matches", "pairs": [{}]}
    assert "few matches" in camera_doubt(doubted)
    assert camera_doubt({**doubted, "pairs": [{}, {}]}) == ""
    assert "62%" in camera_doubt({"confidence": 0.62, "doubt": ""})


def test_masked_pixels_have_no_depth_and_contradict_nothing(room):
    opaque = np.arange(216) < np.full((156, 1), 108)
    first = replace(room.context[0], opaque=opaque, image=room.context[0].image * opaque[..., None])
    sample = replace(room, context=(first, room.context[1]))
    predicted = predict(sample, load_predictor(), 0)
    assert not predicted.geometry.depths[0][~opaque].any()
    assert (predicted.geometry.depths[0][opaque] > 0).mean() > 0.9
    assert predicted.quality.clash < 0.1


@pytest.mark.parametrize("first", [3, 12, 15])
def test_poses_of_other_photographs_are_the_reason_of_a_poor_verdict(real_data, first):
    scene = datasets.load("llff", real_data / "fern")
    names = list(scene.cameras)
    sample = scene.sample(names[first : first + 2])
    shifted = [scene.cameras[name] for name in names[first - 1 : first + 1]]
    wrong = [
        replace(view, camera=replace(view.camera, c2w=camera.c2w))
        for view, camera in zip(sample.context, shifted, strict=True)
    ]
    assert check_pairs(sample)[0].precise > 0.9
    assert check_pairs(replace(sample, context=tuple(wrong)))[0].precise < 0.3
    poor = replace(GOOD, agreement=0.2, clash=0.4)
    assert "something moved" in poor.verdict().reason
    doubted = replace(poor, contradicted=True)
    assert "the cameras contradict the matches" in doubted.verdict().reason
    assert "contradicted" not in GOOD.as_json() and Quality(**doubted.as_json()) == doubted
