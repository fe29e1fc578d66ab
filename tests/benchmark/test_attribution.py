"""Attribution of errors: rooms in which one stage is broken; the verdict must name it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.benchmark import attribution
from slgaussian.benchmark.annotations import Truth
from slgaussian.benchmark.attribution import STAGES, UNFIXABLE, attribute_errors, verdict
from slgaussian.benchmark.evaluate import EvaluationSettings
from slgaussian.components.method import Method
from slgaussian.labels import LabelMaps
from slgaussian.language import load_codes, load_encoder
from slgaussian.language.bank import MemoryBank, build_bank
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.rules import Rules
from slgaussian.predict.unproject import unproject
from slgaussian.scene import Camera, Sample, View
from slgaussian.storage.specs import load_spec
from tests.known import known_field


def build(sample, labels, ratio=1.0):
    """Build a field from labels, true or scaled geometry, and known names of the objects."""
    cameras, depths, colours = zip(
        *((v.camera, v.depth, v.image.astype(np.float32) / 255) for v in sample.context),
        strict=True,
    )
    inverse = [(1 / (ratio * depth)).astype(np.float32) for depth in depths]
    gaussians = unproject(cameras, colours, inverse, [np.ones_like(depth) for depth in depths])
    label_maps = LabelMaps(labels, np.ones(labels.shape, np.float32))
    codes = load_codes("grid")(label_maps, np.random.default_rng(0))
    bank = build_bank(sample.context, label_maps, load_encoder("lexicon"), codes)
    texts = [sample.phrases.get(int(number), "wall") for number in bank.ids]
    vectors = load_encoder("lexicon").encode_text(texts)[:, None].astype(np.float16)
    present = bank.present & np.isin(bank.ids, list(sample.phrases))[:, None]
    features = np.where(present[..., None], vectors, 0).astype(np.float32)
    boxes = np.where(present[..., None], bank.boxes, 0)
    named = replace(bank, features=features, present=present, boxes=boxes)
    return known_field(sample, gaussians, label_maps, Method(codes="grid", keep="all"), named)


@pytest.fixture(scope="module")
def exact(room):
    """Return the room with its true geometry and names, in which no query is missed."""
    return build(room.sample, room.label_maps.labels)


def make_rows(room, field, **settings):
    """Return the rows of the attribution by query."""
    gaussians = room.gaussians if field is room.field else field.gaussians
    evaluation = EvaluationSettings(**settings)
    rows = attribute_errors(field, gaussians, room.sample, Truth(room.truth), evaluation)
    return {row["query"]: row for row in rows}


@pytest.fixture(scope="module")
def thing(room):
    """Return the id of the largest object inside the target, and of the object around it."""
    instances = room.sample.targets[0].instances
    inner = instances[4:-4, 4:-4]
    areas = {k: (inner == k).sum() for k in room.sample.phrases if (instances == k).sum()}
    phrases = list(room.sample.phrases.values())
    largest = max(
        (k for k in areas if areas[k] == (instances == k).sum()),
        key=lambda k: areas[k] * (phrases.count(room.sample.phrases[k]) == 1),
    )
    ids, counts = np.unique(room.label_maps.labels, return_counts=True)
    counts[np.isin(ids, [0, largest])] = 0
    return largest, int(ids[counts.argmax()])


def test_attribution_finds_no_miss_in_an_exact_scene(room, exact):
    rows = make_rows(room, exact)
    assert rows.keys() == room.truth["view_01"].keys()
    # The middle of the narrow table's mask is off it, however true all is.
    assert sum(row["lost"] is not None for row in rows.values()) <= 1
    for row in rows.values():
        assert list(row) == list(load_spec("attribution").columns)
        assert row["masks_iou"] > 0.6


def test_attribution_has_the_scores_of_the_benchmark(room, result):
    scored = {row["query"]: row for row in result.rows if row["protocol"] == "slgaussian@2"}
    for query, row in make_rows(room, room.field).items():
        assert (row["iou"], row["hit"]) == (scored[query]["iou"], scored[query]["hit_mask"])
        assert row["threshold_iou"] >= row["iou"]


def test_attribution_names_threshold_or_language_for_a_wrong_rule_or_vector(room, exact, thing):
    phrase = room.sample.phrases[thing[0]]
    row = make_rows(room, exact, rules=Rules(threshold=0.99999))[phrase]
    assert row["iou"] == 0 and row["threshold_iou"] > 0.5
    assert row["lost"] == "threshold"
    places = np.searchsorted(exact.bank.ids, thing)
    features = exact.bank.features.copy()
    features[places] = exact.bank.features[places[::-1]]
    wrong = exact.with_changes(bank=replace(exact.bank, features=features))
    row = make_rows(room, wrong)[phrase]
    assert row["threshold_iou"] < 0.5 < row["language_iou"]
    assert row["lost"] == "language"


def test_attribution_names_masks_for_objects_in_pieces_unless_a_group_joins_them(room, thing):
    phrase, labels = room.sample.phrases[thing[0]], room.label_maps.labels
    rows, columns = np.indices(labels.shape[1:]) // 5
    squares = int(labels.max()) + 1 + rows * (columns.max() + 1) + columns
    field = build(room.sample, np.where(labels == thing[0], squares, labels).astype(np.int32))
    # The pieces have no name, so no view says anything of them, and words choose others.
    row = make_rows(room, field)[phrase]
    assert row["language_iou"] < 0.5 and row["lost"] == "masks"
    bank, pieces = field.bank, ~np.isin(field.bank.ids, room.label_maps.ids)
    levels = np.where(pieces, len(bank), np.arange(len(bank)))[None].astype(np.int32)
    wrong = field.encoder.encode_text([room.sample.phrases[thing[1]]])
    words = np.repeat(wrong[None], bank.present.shape[1], 1).astype(np.float32)
    row = make_rows(
        room, field.with_changes(bank=replace(bank, levels=levels, group_features=words))
    )
    assert row[phrase]["language_iou"] > 0.5 and row[phrase]["lost"] == "language"


def test_attribution_names_no_stage_for_wrong_depth(room):
    rows = make_rows(room, build(room.sample, room.label_maps.labels, 0.45))
    things = [row for row in rows.values() if room.truth["view_01"][row["query"]].sum() < 700]
    assert len(things) >= 5
    for row in things:
        assert row["masks_iou"] < 0.5 and row["lost"] == UNFIXABLE


def test_carried_back_omits_occluded_pixels():
    """The scene is a wall behind a board that only the target shows."""
    K = np.array([[40.0, 0, 20], [0, 40, 15], [0, 0, 1]])
    aside = np.eye(4)
    aside[0, 3] = 0.5
    image = np.zeros((30, 40, 3), np.uint8)
    image[:, ::2] = 255
    wall = np.full((30, 40), 2.0, np.float32)
    board = wall.copy()
    board[10:20, 15:25] = 1.0
    a = View("a", Camera(K, np.eye(4), 40, 30), image, wall)
    b = View("b", Camera(K, aside, 40, 30), image[:, ::-1].copy(), wall)
    target = View("t", Camera(K, np.eye(4), 40, 30), image, board)
    sample = Sample("wall", (a, b), (target,))
    place = attribution.carried_back(sample, target, np.stack([wall, wall]))
    expected = np.where(board == 2, np.arange(1200).reshape(30, 40), -1)
    assert np.array_equal(place[0], expected)
    # The second camera is 0.5 to the right: 10 pixels at a depth of 2.
    assert np.array_equal(place[1][:, :30], expected[:, 10:])
    assert (place[1][:, 30:] == -1).all()


OBJECTS = st.tuples(st.integers(0, 6), st.integers(0, 6), st.sampled_from([0.2, 0.5, 0.7, 0.9]))


@given(st.lists(OBJECTS.filter(lambda parts: parts[0] + parts[1]), min_size=1, max_size=7))
@settings(max_examples=100, deadline=None)
def test_best_prefix_equals_the_best_threshold_of_all(objects):
    inside, outside, scores = np.array(objects).T
    total = int(inside.sum()) + 1
    chosen = attribution.best_prefix(scores, inside, inside + outside, total)

    def iou(some):
        return inside[some].sum() / (total + outside[some].sum())

    assert iou(chosen) == pytest.approx(max(iou(scores >= t) for t in (*scores, 1)), abs=1e-12)
    assert not chosen.any() or (chosen == (scores >= scores[chosen].min())).all()


def test_best_objects_are_as_many_as_parts_of_the_truth():
    """A sofa has three parts; a chair has one."""
    ids = np.zeros((20, 40), np.int32)
    for k in range(3):
        ids[5:15, 5 * k : 5 * k + 5] = k + 1
    ids[5:15, 30:35] = 4
    unit = np.ones((4, 1, 1), np.float32)
    codes = np.linspace([0, 0, 0], [1, 1, 1], 4, dtype=np.float32)
    numbers = np.arange(1, 5, dtype=np.int32)
    bank = MemoryBank(numbers, codes, unit, np.ones((4, 1), bool))
    levels = np.array([[4, 4, 4, 3]], np.int32)
    grouped = replace(bank, levels=levels, group_features=unit[:1])
    object_map = ObjectMap(ids, numbers)
    sofa, both = (ids > 0) & (ids < 4), ids > 0
    both[0, 20] = True  # a crumb
    assert attribution.best_objects(object_map, bank, sofa).sum() == 1
    assert attribution.best_objects(object_map, grouped, sofa).tolist() == [True, True, True, False]
    assert attribution.best_objects(object_map, grouped, both).all()
    assert not attribution.best_objects(object_map, grouped, ids == 0)[3]


def test_verdict_names_the_first_stage_that_repairs_a_miss():
    row = {"iou": 0.4, "hit": True}
    row |= {f"{name}_iou": 0.4 for name in STAGES} | {f"{name}_hit": True for name in STAGES}
    assert verdict(row) == UNFIXABLE
    for stage in reversed(STAGES):
        row[f"{stage}_iou"] = 0.5
        assert verdict(row) == stage
        assert verdict(row | {f"{stage}_hit": False}) != stage
    assert verdict(row | {"iou": 0.9, "hit": False}) == "threshold"
    assert verdict(row | {"iou": 0.5}) is None
