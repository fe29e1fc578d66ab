from dataclasses import replace

import numpy as np
import pytest

from data_specs import load_spec
from slgaussian.benchmark import metrics
from slgaussian.benchmark.evaluate import (
    ALONG_THE_WAY,
    NOT_UNDERSTOOD,
    camera_between,
    evaluate,
    truth_from_instances,
)
from slgaussian.errors import InputError
from slgaussian.gaussians import source_depths
from slgaussian.language.query import Rules
from slgaussian.scene import Sample


def row_of(result, query):
    (row,) = (row for row in result.rows if row["query"] == query)
    return row


def test_every_query_of_the_truth_has_a_row_with_the_columns_of_the_spec(room, result):
    asked = [row["query"] for row in result.rows]
    assert asked == [*room.truth["view_01"], "qqwx", "red sofa", "grey floor"]
    columns = load_spec("samples").columns
    for row in result.rows:
        assert list(row) == list(columns)
        assert all(columns[name].nullable for name, value in row.items() if value is None)


def test_scores_are_those_of_the_predicted_masks_and_points(room, result):
    view = room.field.render(room.sample.targets[0].camera)
    for query, mask in room.truth["view_01"].items():
        row, found = row_of(result, query), result.predictions["view_01", query]
        hit = view.query(query)
        assert np.array_equal(found, hit.mask)
        assert row["iou"] == metrics.iou(found, mask)
        assert row["hit_mask"] == mask[hit.point[1], hit.point[0]]
        assert (row["point_x"], row["point_y"], row["score"]) == (*hit.point, hit.score)
        # The box of a mask holds the mask.
        assert row["hit_box"] or not row["hit_mask"]


def test_the_field_of_a_known_room_answers_most_of_its_phrases(result):
    # True labels and predicted depth: only the words and the geometry can be wrong.
    assert result.scene_metrics["hit_mask"] > 0.5
    assert result.scene_metrics["psnr"] > 18


def test_an_unknown_word_scores_zero_and_stays_in_the_means(room, result):
    row = row_of(result, "qqwx")
    assert (row["iou"], row["hit_mask"], row["hit_box"]) == (0.0, False, False)
    assert row["hit_peak"] is False
    assert row["note"] == NOT_UNDERSTOOD
    assert row["score"] is None and row["point_x"] is None
    assert not result.predictions["view_01", "qqwx"].any()
    scored = [row["iou"] for row in result.rows if row["iou"] is not None]
    assert len(scored) == len(room.truth["view_01"]) + 1
    assert result.scene_metrics["iou"] == pytest.approx(np.mean(scored), abs=1e-12)
    without = evaluate(room.field, room.sample, room.label_maps, room.truth)
    n = len(room.truth["view_01"])
    assert result.scene_metrics["miou"] == pytest.approx(
        without.scene_metrics["miou"] * n / (n + 1), abs=0.02
    )


def test_what_the_frame_does_not_show_is_reported_and_not_scored(result):
    absent, untold = row_of(result, "red sofa"), row_of(result, "grey floor")
    for row in (absent, untold):
        assert row["iou"] is row["hit_mask"] is row["hit_box"] is row["hit_peak"] is None
        assert row["score"] is not None
    assert "not in this frame" in absent["note"]
    assert untold["frame"] == "halfway"


def test_words_left_out_of_a_query_are_noted(room):
    mask = next(iter(room.truth["view_01"].values()))
    result = evaluate(room.field, room.sample, room.label_maps, {"view_01": {"green qqwx": mask}})
    assert result.rows[0]["note"] == "unknown: qqwx"


def test_annotated_boxes_take_the_place_of_the_masks_own(room):
    whole, nowhere = np.array([[0.0, 0, 143, 103]]), np.zeros((0, 4))
    first, *others = room.truth["view_01"]
    boxes = {"view_01": {first: nowhere} | dict.fromkeys(others, whole)}
    result = evaluate(room.field, room.sample, room.label_maps, room.truth, boxes=boxes)
    assert [row["hit_box"] for row in result.rows] == [False] + [True] * len(others)


def test_a_threshold_changes_the_protocol_and_the_masks(room):
    rules = Rules(threshold=0.999999, canonical="lerf", absent="zero")
    result = evaluate(room.field, room.sample, room.label_maps, room.truth, rules=rules)
    said = ("protocol", "threshold", "share", "canonical", "absent")
    phrases = "object, things, stuff, texture"
    expected = ("threshold", 0.999999, None, phrases, "zero")
    assert {tuple(row[name] for name in said) for row in result.rows} == {expected}
    assert not any(mask.any() for mask in result.predictions.values())


def test_depth_is_judged_where_the_truth_is_known(room, result):
    depths = source_depths(room.field.gaussians, [v.camera for v in room.sample.context])
    scores = [
        metrics.depth_errors(depth, view.depth)
        for depth, view in zip(depths, room.sample.context, strict=True)
    ]
    for name in ("abs_rel", "delta125"):
        expected = np.mean([score[name] for score in scores])
        assert result.scene_metrics[name] == pytest.approx(expected, abs=1e-12)
    assert 0 < result.scene_metrics["target_abs_rel"] < 0.3
    # These cameras turn towards each other: no pixel has one disparity.
    assert "bad2" not in result.scene_metrics


def test_a_rectified_pair_is_judged_in_pixels_of_disparity(room):
    a = room.sample.context[0]
    move = np.eye(4)
    move[0, 3] = 0.3
    camera = replace(a.camera, c2w=a.camera.c2w @ move)
    beside = replace(a, name="beside", camera=camera, image=255 - a.image)  # no mere copy
    pair = Sample("pair", (a, beside))
    result = evaluate(room.field, pair, room.label_maps, {})
    depths = source_depths(room.field.gaussians, [view.camera for view in pair.context])
    expected = [
        metrics.depth_errors(depth, a.depth, a.camera.K[0, 0] * 0.3)["bad2"] for depth in depths
    ]
    assert result.scene_metrics["bad2"] == pytest.approx(np.mean(expected), abs=1e-12)


def test_pictures_show_every_view_viewpoint_and_query(result):
    kinds = ("input", "labels", "depth", "true_depth", "depth_error")
    expected = {f"{kind}/{view}" for kind in kinds for view in ("view_00", "view_02")}
    expected |= {f"{kind}/view_01" for kind in ("photo", "render", "ids")}
    expected |= {f"{kind}/{frame}" for kind in ("render", "ids") for frame in ALONG_THE_WAY}
    for frame, query in result.predictions:
        expected |= {f"relevancy/{frame}/{query}", f"mask/{frame}/{query}"}
    assert set(result.pictures) == expected | {"objects/all"}
    for name, picture in result.pictures.items():
        assert picture.dtype == np.uint8
        assert name == "objects/all" or picture.shape == (104, 144, 3)


def test_the_same_field_gives_the_same_result(room, result):
    again = room.evaluate_all()
    assert again.rows == result.rows
    assert again.scene_metrics == result.scene_metrics
    for name, picture in again.pictures.items():
        assert np.array_equal(picture, result.pictures[name])


def test_truth_from_instances_unites_equal_phrases_and_leaves_out_the_unseen(room):
    target = room.sample.targets[0]
    seen = np.unique(target.instances)
    one, two = seen[seen > 0][:2]
    phrases = {int(one): "ball", int(two): "ball", 999: "ghost"}
    sample = Sample("s", room.sample.context, (target,), phrases)
    truth = truth_from_instances(sample)
    assert list(truth["view_01"]) == ["ball"]
    assert np.array_equal(truth["view_01"]["ball"], np.isin(target.instances, [one, two]))


def test_a_truth_that_does_not_fit_is_refused(room):
    mask = np.zeros((104, 144), bool)
    with pytest.raises(InputError, match="'view_00', which is not a target view"):
        evaluate(room.field, room.sample, room.label_maps, {"view_00": {"ball": mask}})
    with pytest.raises(InputError, match=r"'ball' in 'view_01' is bool \(52, 144\)"):
        evaluate(room.field, room.sample, room.label_maps, {"view_01": {"ball": mask[::2]}})
    with pytest.raises(InputError, match="is uint8"):
        evaluate(
            room.field, room.sample, room.label_maps, {"view_01": {"ball": mask.astype(np.uint8)}}
        )


def test_langsplat_is_scored_by_its_masks_and_by_any_pixel_of_its_peak(room, result):
    rules = Rules(protocol="langsplat")
    scored = evaluate(room.field, room.sample, room.label_maps, room.truth, rules=rules)
    view = room.field.render(room.sample.targets[0].camera)
    for row in scored.rows:
        hit = view.query(row["query"], protocol="langsplat")
        truth = room.truth["view_01"][row["query"]]
        assert row["protocol"] == "langsplat"
        assert row["iou"] == metrics.iou(hit.mask, truth)
        ys, xs = np.nonzero(truth)
        box = np.s_[ys.min() : ys.max() + 1, xs.min() : xs.max() + 1]
        assert row["hit_peak"] == hit.peak[box].any()
        # The point is a pixel of the peak.
        assert row["hit_peak"] or not row["hit_box"]
        # Relevancies do not depend on the protocol.
        assert row["score"] == row_of(result, row["query"])["score"]


def test_the_camera_between_starts_and_ends_at_the_two(room):
    a, b = (view.camera for view in room.sample.context)
    for t, end in ((0.0, a), (1.0, b)):
        camera = camera_between(a, b, t)
        assert camera.c2w == pytest.approx(end.c2w, abs=1e-9)
        assert pytest.approx(end.K, abs=1e-9) == camera.K
    middle = camera_between(a, b, 0.5)
    assert middle.center == pytest.approx((a.center + b.center) / 2, abs=1e-12)
    # Half the turn, made twice, is the whole turn.
    half = middle.c2w[:3, :3] @ a.c2w[:3, :3].T
    assert half @ half == pytest.approx(b.c2w[:3, :3] @ a.c2w[:3, :3].T, abs=1e-9)
