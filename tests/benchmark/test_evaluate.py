from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slgaussian.benchmark import metrics
from slgaussian.benchmark.annotations import Truth
from slgaussian.benchmark.evaluate import (
    ABSENT,
    NOT_UNDERSTOOD,
    EvaluationSettings,
    evaluate,
    truth_from_instances,
)
from slgaussian.errors import InputError
from slgaussian.gaussians import source_depths
from slgaussian.language.rules import Rules
from slgaussian.language.wholes import NEAR_BEST
from slgaussian.scene import Sample
from slgaussian.storage.specs import load_spec


def find_rows(result, protocol="slgaussian"):
    return [row for row in result.rows if row["protocol"] == f"{protocol}@2"]


def find_row(result, query, protocol="slgaussian"):
    (row,) = (row for row in find_rows(result, protocol) if row["query"] == query)
    return row


def test_evaluate_returns_a_row_per_query_with_all_columns(room, result):
    texts = [*room.truth["view_01"], "qqwx"]
    assert [row["query"] for row in find_rows(result)] == [*texts, "red sofa", "grey floor"]
    for protocol in ("langsplat", "langsplat-rescaled", "3d-ovs"):
        assert [row["query"] for row in find_rows(result, protocol)] == texts
    columns = load_spec("samples").columns
    for row in result.rows:
        assert list(row) == list(columns)
        assert all(columns[name].nullable for name, value in row.items() if value is None)


def test_evaluate_scores_equal_those_of_masks_and_points(room, result):
    view = room.field.render(room.sample.targets[0].camera)
    for query, mask in room.truth["view_01"].items():
        row, predicted = (
            find_row(result, query),
            result.predictions["slgaussian@2", "view_01", query],
        )
        hit = view.query(query)
        assert np.array_equal(predicted, hit.mask)
        assert row["iou"] == metrics.iou(predicted, mask)
        assert row["hit_mask"] == mask[hit.point[1], hit.point[0]]
        assert (row["point_x"], row["point_y"], row["score"]) == (*hit.point, hit.score)
        # The box of a mask holds the mask.
        assert row["hit_box"] or not row["hit_mask"]


def test_evaluate_scores_an_unknown_word_as_zero(result):
    names = ("iou", "boundary_iou", "class_iou", "hit_mask", "hit_box", "hit_peak")
    for protocol in ("slgaussian", "langsplat", "langsplat-rescaled", "3d-ovs"):
        row = find_row(result, "qqwx", protocol)
        assert {row[name] for name in names} == {0, None}
        assert row["note"] == NOT_UNDERSTOOD
        assert row["score"] is row["point_x"] is None
        assert not result.predictions[f"{protocol}@2", "view_01", "qqwx"].any()
    for metric, column in (("iou", "iou"), ("miou", "class_iou")):
        scored = [row[column] for row in find_rows(result) if row[column] is not None]
        assert result.scene_metrics[metric] == pytest.approx(np.mean(scored), abs=1e-12)


def test_evaluate_reports_queries_without_truth_but_no_scores(result):
    absent, untold = find_row(result, "red sofa"), find_row(result, "grey floor")
    for row in (absent, untold):
        assert row["iou"] is row["hit_mask"] is row["hit_box"] is row["class_iou"] is None
        assert row["score"] is not None and row["point_x"] is not None
        assert ("slgaussian@2", row["frame"], row["query"]) in result.predictions
    assert absent["note"] == "not in this frame" and untold["note"] == ""
    assert untold["frame"] == "halfway"


def test_evaluate_prefers_annotated_boxes_to_boxes_of_masks(room):
    everywhere, nowhere = np.array([[0.0, 0, 143, 103]]), np.zeros((0, 4))
    first, *rest = room.truth["view_01"]
    boxes = {"view_01": {first: nowhere} | dict.fromkeys(rest, everywhere)}
    result = room.evaluate(boxes=boxes)
    for protocol, column in (("slgaussian", "hit_box"), ("langsplat", "hit_peak")):
        hits = [row[column] for row in find_rows(result, protocol)]
        assert hits == [False] + [True] * len(rest)


def test_evaluate_rows_state_mask_settings(room, result):
    def settings(result, protocol):
        names = ("selection", "threshold", "share", "filter", "temperature", "canonical", "absent")
        (values,) = {tuple(row[name] for name in names) for row in find_rows(result, protocol)}
        return values

    rules = (10, "encoder's", "skip")
    assert settings(result, "slgaussian") == ("near-best", None, NEAR_BEST, None, *rules)
    assert settings(result, "langsplat") == ("stretched", 0.4, None, 30, *rules)
    # 30 of 988 pixels, of 144
    assert settings(result, "langsplat-rescaled") == ("stretched", 0.4, None, 4, *rules)
    assert settings(result, "3d-ovs") == ("arg-max", None, None, None, *rules)
    cut = room.evaluate(
        rules=Rules(threshold=0.999999, canonical="lerf", absent="zero", temperature=2)
    )
    rules = (2, "object, things, stuff, texture", "zero")
    assert settings(cut, "slgaussian") == ("threshold", 0.999999, None, None, *rules)
    masks = [m for (protocol, *_), m in cut.predictions.items() if protocol == "slgaussian@2"]
    assert len(masks) == len(room.truth["view_01"])
    assert not any(mask.any() for mask in masks)
    # Texts compete for every pixel, however low its score.
    assert cut.predictions["3d-ovs@2", "view_01", next(iter(room.truth["view_01"]))].any()


def depth_scores(room, sample, scale=None):
    depths = source_depths(room.gaussians, [view.camera for view in sample.context])
    pairs = zip(depths, sample.context, strict=True)
    scores = [metrics.depth_errors(depth, view.depth, scale) for depth, view in pairs]
    return {name: pytest.approx(np.mean([s[name] for s in scores])) for name in scores[0]}


def test_evaluate_scores_depth_with_known_truth(room, result):
    assert result.scene_metrics.items() >= depth_scores(room, room.sample).items()
    assert 0 < result.scene_metrics["target_abs_rel"] < 0.3
    # These cameras turn towards each other: no pixel has one disparity.
    assert "bad2" not in result.scene_metrics
    # A rectified pair is judged in pixels of disparity.
    a, move = room.sample.context[0], np.eye(4)
    move[0, 3] = 0.3
    camera = replace(a.camera, c2w=a.camera.c2w @ move)
    beside = replace(a, name="beside", camera=camera, image=255 - a.image)  # no mere copy
    pair = Sample("pair", (a, beside))
    result = evaluate(room.field, pair, room.label_maps, Truth(), gaussians=room.gaussians)
    expected = depth_scores(room, pair, a.camera.K[0, 0] * 0.3)
    assert result.scene_metrics.items() >= expected.items() and "bad2" in expected


def test_truth_from_instances_unites_equal_phrases_and_omits_invisible_ones(room):
    target = room.sample.targets[0]
    ids = np.unique(target.instances)
    one, two = ids[ids > 0][:2]
    phrases = {int(one): "ball", int(two): "ball", 999: "ghost"}
    sample = Sample("s", room.sample.context, (target,), phrases)
    truth = truth_from_instances(sample).masks
    assert list(truth["view_01"]) == ["ball"]
    assert np.array_equal(truth["view_01"]["ball"], np.isin(target.instances, [one, two]))


def test_evaluate_takes_pictures_and_metrics_from_the_first_protocol(room, own_result):
    """The first protocol decides pictures and metrics of the scene, but no score."""
    led = room.evaluate(protocols=["langsplat", "slgaussian", "3d-ovs"])
    assert led.rows[0]["protocol"] == "langsplat@2"
    assert led.scene_metrics["iou"] == np.mean([row["iou"] for row in find_rows(led, "langsplat")])
    assert "hit_peak" in led.scene_metrics and "hit_mask" not in led.scene_metrics
    for protocol in ("slgaussian", "langsplat", "3d-ovs"):
        assert find_rows(led, protocol) == find_rows(own_result, protocol)
    name = f"mask/view_01/{next(iter(room.truth['view_01']))}"
    assert not np.array_equal(led.pictures[name], own_result.pictures[name])
    with pytest.raises(InputError, match="protocol: found 'lerf', expected one of slgaussian, "):
        room.evaluate(protocols=["lerf"])


class Watched:
    """A method with the required interface only, which records its queries.

    Rendering takes 100 seconds of a simulated clock, a text 1, and the first answer 1000 more.
    """

    def __init__(self, field, relevancy=None):
        self.field, self.relevancy = field, relevancy
        self.asked, self.now, self.once = [], 0.0, 1000

    def render(self, camera):
        self.asked.append("render")
        self.now += 100
        view = self.field.render(camera)
        no_ids, no_depth = np.zeros_like(view.ids), np.zeros_like(view.depth)

        def query_all(texts, **rules):
            self.asked.append("query")
            self.now += len(texts) + self.once
            self.once = 0
            return [self.replace_relevancy(hit) for hit in view.query_all(texts, **rules)]

        def segment(texts, **rules):
            self.asked.append("segment")
            return view.segment(texts, **rules)

        return SimpleNamespace(
            rgb=view.rgb,
            ids=no_ids,
            depth=no_depth,
            reader=view.reader,
            query_all=query_all,
            segment=segment,
        )

    def replace_relevancy(self, hit):
        if self.relevancy is None:
            return hit
        names = ("text", "mask", "point", "score", "objects", "unknown")
        return SimpleNamespace(
            relevancy=self.relevancy, **{name: getattr(hit, name) for name in names}
        )


def test_evaluate_queries_a_method_once_for_all_protocols(room, own_result, monkeypatch):
    method, other = Watched(room.field), replace(room.sample.targets[0], name="other")
    monkeypatch.setattr("slgaussian.benchmark.evaluate.compiling.clock", lambda: method.now)
    sample = replace(room.sample, targets=(*room.sample.targets, other))
    masks = room.truth["view_01"] | {"qqwx": next(iter(room.truth["view_01"].values()))}
    truth = Truth({"view_01": room.truth["view_01"], "other": masks})
    result = evaluate(method, sample, room.label_maps, truth)
    # An untimed answer; two targets, whose first text is asked alone to time it; then three views
    # along the way.
    untimed, target = ["render", "query"], ["render", "query", "query", "segment"]
    assert method.asked == [*untimed, *target, *target, *["render"] * 3]
    assert [row for row in result.rows if row["frame"] == "view_01"] == own_result.rows
    # A method that does not know depths is not judged by them, and none are drawn without any.
    assert not {"target_abs_rel", "abs_rel", "near"} & set(result.scene_metrics)
    assert not any(name.startswith("depth/") for name in result.pictures)
    # 100 to draw a view, 1 a text, and 1000 once, which no answer includes.
    names = {"dataset": "scenes", "scene": room.sample.scene, "method": "slgaussian"}
    seconds = {text: None if text == "qqwx" else 1 for text in masks}
    assert [{**row, "peak_bytes": 0} for row in result.costs] == [
        {
            **names,
            "frame": frame,
            "query": text,
            "view_seconds": 101,
            "query_seconds": seconds[text],
        }
        | {"peak_bytes": 0}
        for frame, texts in truth.masks.items()
        for text in texts
    ]
    bare = evaluate(method, sample, room.label_maps, truth, EvaluationSettings(drawn=False))
    assert bare.rows == result.rows and bare.pictures == {}


@pytest.mark.parametrize(
    ("relevancy", "message"),
    [
        (np.full((104, 144), np.nan), "relevancy goes from nan to nan"),
        (np.full((104, 144), -0.1), "goes from -0.1 to -0.1, expected numbers from 0 to 1"),
        (np.full((104, 144), np.inf), "goes from inf"),
        (np.ones((52, 144)), r"the relevancy is \(52, 144\), expected \(104, 144\)"),
    ],
)
def test_evaluate_refuses_an_invalid_relevancy(room, relevancy, message):
    query = next(iter(room.truth["view_01"]))
    with pytest.raises(InputError, match=f"'view_01': '{query}': .*{message}"):
        evaluate(Watched(room.field, relevancy), room.sample, room.label_maps, Truth(room.truth))


def test_evaluate_scores_extreme_masks_without_nan(room):
    """Masks of one pixel, all pixels and none; and a known word that the room does not show."""
    some = next(iter(room.truth["view_01"].values()))
    one, corner = np.zeros_like(some), np.zeros_like(some)
    one[50, 70] = corner[0, 0] = True
    masks = {"red crate": one, "grey floor": one | True, "blue sofa": one & False, "zzgl": corner}
    masks["red qqwx"] = masks["blue sofa"]
    result = room.evaluate({"view_01": masks})
    numbers = [value for row in result.rows for value in row.values() if isinstance(value, float)]
    assert numbers and np.isfinite([*numbers, *result.scene_metrics.values()]).all()
    assert find_row(result, "red qqwx")["note"] == f"unknown: qqwx; {ABSENT}"
    # Two masks overlap in a pixel, which then is no single class; nothing else can be right.
    assert find_row(result, "red crate", "3d-ovs")["accuracy"] <= 1 - 2 / some.size


def test_evaluate_ignores_transparent_pixels(room):
    """Colours, labels and depth behind the mask are of a thing that nobody photographed."""
    (target,), truth = room.sample.targets, room.truth["view_01"]
    opaque = np.ones(target.image.shape[:2], bool)
    opaque[:, :60] = False
    results = []
    for grey in (0, 255):
        image = np.where(opaque[..., None], target.image, np.uint8(grey))
        depth = np.where(opaque, target.depth, np.float32(grey + 1))
        view = replace(target, image=image, depth=depth, opaque=opaque)
        masks = {text: mask | (~opaque & (grey > 0)) for text, mask in truth.items()}
        sample, settings = replace(room.sample, targets=(view,)), EvaluationSettings(drawn=False)
        inputs = sample, room.label_maps, Truth({"view_01": masks}), settings
        results.append(evaluate(room.field, *inputs))
    first, second = results
    assert first.rows == second.rows and first.scene_metrics == second.scene_metrics
    render = room.field.render(target.camera)
    for query, mask in truth.items():
        if (mask & opaque).any():
            predicted = render.query(query).mask[:, 60:]
            assert find_row(first, query)["iou"] == metrics.iou(predicted, mask[:, 60:])
    seen = render.rgb[:, 60:], target.image[:, 60:]
    assert first.scene_metrics["psnr"] == pytest.approx(metrics.psnr(*seen))
    assert first.scene_metrics["ssim"] == pytest.approx(metrics.ssim(*seen), abs=0.02)
    winners = render.segment(sorted(truth), threshold=0.0)[:, 60:]
    masks = [truth[text][:, 60:] for text in sorted(truth)]
    accuracy = {row["accuracy"] for row in find_rows(first, "3d-ovs") if row["iou"] is not None}
    assert accuracy <= {metrics.exact_accuracy(winners, masks)}
