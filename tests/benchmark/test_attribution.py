"""Rooms in which one stage is broken on purpose: the verdict has to name it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.benchmark import attribution
from slgaussian.benchmark.annotations import Truth
from slgaussian.benchmark.attribution import BEYOND, STAGES, attribute_errors, verdict
from slgaussian.benchmark.evaluate import EvaluationSettings
from slgaussian.components.method import Method
from slgaussian.gaussians import Gaussians, source_depths
from slgaussian.labels import LabelMaps
from slgaussian.language import load_codes, load_encoder
from slgaussian.language.bank import MemoryBank, build_bank
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.rules import Rules
from slgaussian.scene import Camera, Sample, View
from slgaussian.storage.specs import load_spec
from tests.known import known_field


@pytest.fixture(scope="module")
def exact(room):
    """The room with its true geometry and names: nothing in it is lost."""
    cameras = [view.camera for view in room.sample.context]
    depths = source_depths(room.gaussians, cameras)
    gaussians = moved(room.gaussians, room.sample, depths)
    return build(room.sample, gaussians, room.label_maps.labels)


def moved(gaussians: Gaussians, sample: Sample, predicted: np.ndarray) -> Gaussians:
    """Move Gaussians along their lines of sight to the true depth of their source pixels.

    They grow with their distance, and of each pixel the first, which shows it, does not stay faint.
    Those of pixels whose true or ``predicted`` depth [V, H, W] is not known stay as they are.
    """
    true = attribution.true_depths(sample).ravel()
    is_known = (true > 0) & (predicted.ravel() > 0)
    ratio = np.where(is_known, true / np.where(is_known, predicted.ravel(), 1), 1)
    source = gaussians.source.numpy()
    centers = np.stack([view.camera.center for view in sample.context])
    center = torch.from_numpy(centers[source // sample.context[0].image[..., 0].size])
    step = torch.from_numpy(ratio[source].astype(np.float64))[:, None]
    order = np.arange(len(source))
    first = np.empty(len(true), np.int64)
    first[source[::-1]] = order[::-1]
    certain = torch.from_numpy(is_known[source] & (first[source] == order))
    return replace(
        gaussians,
        means=(center + (gaussians.means.double() - center) * step).float(),
        scales=(gaussians.scales * step).float(),
        opacities=torch.where(certain, gaussians.opacities.clamp(min=0.5), gaussians.opacities),
    )


def build(sample, gaussians, labels):
    """A field of these labels that knows what its objects are called."""
    label_maps = LabelMaps(labels, np.ones(labels.shape, np.float32))
    codes = load_codes("grid")(label_maps, np.random.default_rng(0))
    bank = build_bank(sample.context, label_maps, load_encoder("lexicon"), codes)
    ids = [int(id_) for id_ in bank.ids]
    texts = [sample.phrases.get(id_, "wall") for id_ in ids]
    vectors = load_encoder("lexicon").encode_text(texts)[:, None].astype(np.float16)
    present = bank.present & np.isin(ids, list(sample.phrases))[:, None]
    features = np.where(present[..., None], vectors, 0).astype(np.float32)
    boxes = np.where(present[..., None], bank.boxes, 0)
    named = replace(bank, features=features, present=present, boxes=boxes)
    gaussians = replace(gaussians, features=None)
    return known_field(sample, gaussians, label_maps, Method(codes="grid", keep="all"), named)


def of(room, field, truth=None, sample=None, **settings):
    """The rows of the attribution, by query."""
    truth = room.truth if truth is None else truth
    rows = attribute_errors(
        field,
        room.gaussians if field is room.field else field.gaussians,
        sample or room.sample,
        Truth(truth),
        EvaluationSettings(**settings),
    )
    return {row["query"]: row for row in rows}


@pytest.fixture(scope="module")
def thing(room):
    """A thing that lies well inside the target: its phrase and its id."""
    height, width = room.sample.targets[0].image.shape[:2]
    shown = room.sample.targets[0].instances
    edge = np.ones((height, width), bool)
    edge[4:-4, 4:-4] = False
    phrases = list(room.sample.phrases.values())
    areas = {
        (phrase, i): np.count_nonzero(shown == i)
        for i, phrase in room.sample.phrases.items()
        if phrases.count(phrase) == 1 and not (edge & (shown == i)).any()
    }
    return max(areas, key=areas.get)


def around(room, number):
    """What lies around the things of the room: the id with most pixels beside the one given."""
    ids, counts = np.unique(room.label_maps.labels, return_counts=True)
    counts[np.isin(ids, [0, number])] = 0
    return int(ids[counts.argmax()])


def test_nothing_is_lost_where_nothing_is_broken(room, exact):
    rows = of(room, exact)
    assert rows.keys() == room.truth["view_01"].keys()
    # The middle of the narrow table's mask is off it, however true all is.
    assert sum(row["lost"] is not None for row in rows.values()) <= 1
    columns = load_spec("attribution").columns
    for row in rows.values():
        assert list(row) == list(columns)
        assert row["masks_iou"] > 0.6


def test_what_was_found_is_what_the_benchmark_scores(room, result):
    rows = of(room, room.field)
    scored = {row["query"]: row for row in result.rows if row["protocol"] == "slgaussian@2"}
    for query, row in rows.items():
        assert (row["iou"], row["hit"]) == (scored[query]["iou"], scored[query]["hit_mask"])
        assert row["threshold_iou"] >= row["iou"]


def test_an_absurd_threshold_lost_it(room, exact, thing):
    row = of(room, exact, rules=Rules(threshold=0.99999))[thing[0]]
    assert row["iou"] == 0 and row["threshold_iou"] > 0.5
    assert row["lost"] == "threshold"


def test_a_wrong_vector_in_the_bank_is_a_loss_of_language(room, exact, thing):
    phrase, number = thing
    bank = exact.bank
    rows = np.searchsorted(bank.ids, [number, around(room, number)])
    features = bank.features.copy()
    features[rows] = bank.features[rows[::-1]]
    wrong = exact.changed(bank=replace(bank, features=features))
    row = of(room, wrong)[phrase]
    assert row["threshold_iou"] < 0.5 < row["language_iou"]
    assert row["lost"] == "language"


def cut_up(room, number, side=5):
    """The labels with one thing cut up into squares."""
    labels = room.label_maps.labels.copy()
    rows, columns = np.indices(labels.shape[1:]) // side
    squares = int(labels.max()) + 1 + rows * (columns.max() + 1) + columns
    return np.where(labels == number, squares, labels).astype(np.int32)


def test_masks_that_cut_a_thing_up_are_a_loss_of_masks_unless_a_group_holds_it(room, exact, thing):
    phrase, number = thing
    labels = cut_up(room, number)
    field = build(room.sample, exact.gaussians, labels)
    # The pieces have no name, so no view says anything of them, and words choose others.
    row = of(room, field)[phrase]
    assert row["language_iou"] < 0.5 and row["lost"] == "masks"
    bank, ours = field.bank, ~np.isin(field.bank.ids, room.label_maps.ids)
    levels = np.where(ours, len(bank), np.arange(len(bank)))[None].astype(np.int32)
    wrong = field.encoder.encode_text([room.sample.phrases[around(room, number)]])
    said = np.repeat(wrong[None], bank.present.shape[1], 1)
    grouped = replace(bank, levels=levels, group_features=said.astype(np.float32))
    row = of(room, field.changed(bank=grouped))[phrase]
    assert row["language_iou"] > 0.5 and row["lost"] == "language"


def nearer(gaussians, sample, ratio):
    """Gaussians with their depths multiplied by a number."""
    cameras = [view.camera for view in sample.context]
    depths = source_depths(gaussians, cameras)
    wrong = [replace(v, depth=d * ratio) for v, d in zip(sample.context, depths, strict=True)]
    return moved(gaussians, replace(sample, context=tuple(wrong)), depths)


def test_wrong_depth_is_mended_by_nothing(room, exact):
    gaussians = nearer(exact.gaussians, room.sample, np.float32(0.45))
    rows = of(room, build(room.sample, gaussians, room.label_maps.labels))
    things = [row for row in rows.values() if room.truth["view_01"][row["query"]].sum() < 700]
    assert len(things) >= 5
    for row in things:
        assert row["masks_iou"] < 0.5 and row["lost"] == BEYOND


def test_what_something_hides_is_not_carried_back():
    """A wall, and a board in front of its middle that only the target sees."""
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


objects_strategy = st.lists(
    st.tuples(st.integers(0, 6), st.integers(0, 6)).filter(sum), min_size=1, max_size=7
)


@given(objects_strategy, st.data())
@settings(max_examples=100, deadline=None)
def test_the_best_threshold_is_the_best_of_all_thresholds(objects, data):
    inside, outside = np.array(objects).T
    total, areas = int(inside.sum()) + 1, inside + outside
    some = st.lists(
        st.sampled_from([0.2, 0.5, 0.7, 0.9]), min_size=len(objects), max_size=len(objects)
    )
    scores = np.array(data.draw(some))
    chosen = attribution.best_prefix(scores, inside, areas, total)

    def iou(some):
        return inside[some].sum() / (total + outside[some].sum())

    assert iou(chosen) == pytest.approx(max(iou(scores >= t) for t in (*scores, 1)), abs=1e-12)
    assert not chosen.any() or (chosen == (scores >= scores[chosen].min())).all()


def test_whole_things_are_as_many_as_the_truth_has_parts():
    """Three cushions make a sofa; a chair of one piece stands apart."""
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
    seen = ObjectMap(ids, numbers)
    sofa, both = (ids > 0) & (ids < 4), ids > 0
    both[0, 20] = True  # a crumb
    assert attribution.best_objects(seen, bank, sofa).sum() == 1
    assert attribution.best_objects(seen, grouped, sofa).tolist() == [True, True, True, False]
    assert attribution.best_objects(seen, grouped, both).all()
    assert not attribution.best_objects(seen, grouped, ids == 0)[3]


def test_verdicts_follow_the_order_of_the_stages():
    row = {"iou": 0.4, "hit": True}
    row |= {f"{name}_iou": 0.4 for name in STAGES}
    row |= {f"{name}_hit": True for name in STAGES}
    assert verdict(row) == BEYOND
    for stage in reversed(STAGES):
        row[f"{stage}_iou"] = 0.5
        assert verdict(row) == stage
        assert verdict(row | {f"{stage}_hit": False}) != stage
    assert verdict(row | {"iou": 0.9, "hit": False}) == "threshold"
    assert verdict(row | {"iou": 0.5}) is None
