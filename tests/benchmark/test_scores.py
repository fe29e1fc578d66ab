"""Scores from samples: means as defined by LangSplat and 3D-OVS, and their intervals."""

import numpy as np
import pytest
from rows import sample

from slgaussian.benchmark.protocols import PROTOCOLS
from slgaussian.benchmark.scores import (
    FEW_PLACES,
    ONE_PLACE,
    differences,
    scene_means,
    score_table,
)
from slgaussian.benchmark.statistics import CONFIDENCE_LEVEL, MIN_SAMPLES, compare, resample_counts
from slgaussian.errors import InputError
from slgaussian.storage.specs import load_spec


def ious(**by_scene):
    return [
        sample(scene, f"q{k}", iou=value)
        for scene, values in by_scene.items()
        for k, value in enumerate(values)
    ]


def score(rows, metric="iou"):
    (row,) = (row for row in score_table(rows).to_pylist() if row["metric"] == metric)
    return row


def difference(rows, baseline):
    (actual,) = differences(rows, baseline)
    return actual


def test_score_table_weights_scenes_equally():
    row = score(ious(a=[1.0], b=[0.0, 0.5, 0.1]))
    assert row["value"] == pytest.approx((1.0 + 0.2) / 2)
    assert (row["scenes"], row["samples"]) == (2, 4)


def test_score_table_averages_miou_over_classes_and_frames():
    rows = [
        *(sample("a", q, class_iou=v, accuracy=0.5) for q, v in (("x", 0.2), ("y", 0.4))),
        sample("a", "x", frame="g", class_iou=0.9, accuracy=0.8),
        sample("a", "z", frame="g"),
    ]
    # Of accuracies there is one number a frame, however many rows it has.
    expected = {"miou": pytest.approx((0.3 + 0.9) / 2), "accuracy": pytest.approx((0.5 + 0.8) / 2)}
    assert scene_means(rows) == expected
    assert {name: score(rows, name)["value"] for name in expected} == expected
    assert score(rows, "miou")["samples"] == 3


def test_score_table_notes_missing_and_rough_intervals():
    one_scene = score(ious(a=[0.1, 0.9]))
    assert one_scene["low"] is one_scene["high"] is None and one_scene["note"] == ONE_PLACE
    rows = [row | {"place": "one"} for row in ious(a=[0.1], b=[0.9])]
    assert score(rows)["low"] is None and score(rows)["note"] == ONE_PLACE
    two_scenes = score(ious(a=[0.1], b=[0.9]))
    assert (two_scenes["low"], two_scenes["high"], two_scenes["note"]) == (0.1, 0.9, FEW_PLACES)
    row = score(ious(**{f"s{k}": [k / 10] for k in range(MIN_SAMPLES)}))
    assert row["note"] == "" and row["low"] < row["value"] < row["high"]
    assert row["level"] == CONFIDENCE_LEVEL


def test_score_table_resamples_places_then_scenes():
    """Comparison with plain loops: the mean over all drawn scenes.

    There are enough places that no end of an interval is a resampling of one place only, whose
    score would not depend on the weights.
    """
    rng = np.random.default_rng(4)
    rows = []
    for place, scenes in enumerate((1, 1, 2, 1, 5, 1, 1)):
        for scene in range(scenes):
            iou = rng.random() / 4 + (scenes > 2)  # the place of many scenes is the best by far
            rows.append(sample(f"s{place}{scene}", "q", place=f"place {place}", iou=iou))
    values = [row["iou"] for row in rows]
    means = [np.repeat(values, n).mean() for n in resample_counts(tuple(r["place"] for r in rows))]
    ends = pytest.approx(tuple(np.quantile(means, [0.025, 0.975])), abs=1e-9)
    row = score(rows)
    assert (row["low"], row["high"]) == ends
    assert row["places"] == 7 and row["note"] == ""
    gain = difference(rows, [row | {"iou": 0.0} for row in rows]).gain
    assert (gain.low, gain.high) == ends


def test_score_table_has_the_columns_of_the_spec(result):
    table = score_table(result.rows)
    load_spec("scores").check_table(table, "scores")
    actual = {}
    for row in table.to_pylist():
        actual.setdefault(row["protocol"], []).append(row["metric"])
        assert row["scenes"] == 1 and row["note"] == ONE_PLACE
        assert row["filter"] == {"langsplat@2": "30", "langsplat-rescaled@2": "4"}.get(
            row["protocol"]
        )
        if row["protocol"] == "slgaussian@2":
            assert row["value"] == result.scene_metrics[row["metric"]]
    langsplat = ["iou", "boundary_iou", "hit_box", "hit_peak"]
    assert actual == {
        "slgaussian@2": ["iou", "boundary_iou", "miou", "hit_mask", "hit_box"],
        "langsplat@2": langsplat,
        "langsplat-rescaled@2": langsplat,
        "3d-ovs@2": ["boundary_iou", "miou", "accuracy"],
        "highest-pixel@1": ["hit_mask", "hit_box", "hit_peak"],
    }
    assert list(actual) == [protocol.label for protocol in PROTOCOLS.values()]


def test_score_table_refuses_samples_of_several_settings():
    rows = [sample("a", "x", iou=0.1), sample("b", "x", iou=0.2, temperature=1.0)]
    message = "scores of m by slgaussian@2: samples were made with temperature 1.0, 10.0"
    with pytest.raises(InputError, match=message):
        score_table(rows)
    # A filter that goes with the images' width is one setting.
    rows = [sample("a", "x", iou=0.1, filter=17), sample("b", "x", iou=0.2, filter=9)]
    assert score(rows)["filter"] == "9, 17"


def test_differences_use_common_samples_only():
    mine = ious(a=[0.9, 0.5], b=[0.4], c=[0.8])
    theirs = [*ious(a=[0.7], b=[0.1]), sample("c", "q0"), sample("d", "q0", iou=0.0)]
    actual = difference(mine, theirs)
    assert actual.gain == compare([0.9, 0.4], [0.7, 0.1])
    assert (actual.gain.samples, actual.samples) == (2, 2)
    assert difference(theirs, mine).gain.low == pytest.approx(-actual.gain.high)
    with pytest.raises(InputError, match="'q0' in 'f' of scene 'a' is there twice by slgaussian@2"):
        differences([*mine, sample("a", "q0", iou=0.1, method="n")], mine)
