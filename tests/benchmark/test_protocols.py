"""Protocols compared with reference scores, on synthetic and real polygons, easy and hard."""

import cv2
import numpy as np
import plain
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.benchmark.protocols import PROTOCOLS, Answer, Frame, load_protocol
from slgaussian.language.rules import Rules

SHAPE = (52, 72)
NEAR = 1e-12
"""Sums of float64 in another order. Over all frames of the office set and 60 of random polygons the
most that differed was 2.3e-16; counts, hits and IoUs are equal."""


def scored(name, frame, rules=None):
    protocol = load_protocol(name)
    return protocol.score(frame, protocol.mask_settings(rules or Rules(), frame.labels.shape[1]))


def check(frame):
    """Check that all scores of all queries equal the reference."""
    for name in PROTOCOLS:
        for k, item in enumerate(scored(name, frame)):
            if not frame.masks[k].any():
                assert item.scores == {}
                continue
            expected = plain.scores(name, frame, k)
            assert set(item.scores) == set(expected)
            for key, value in expected.items():
                assert item.scores[key] == pytest.approx(value, abs=NEAR), key
                assert 0 <= item.scores[key] <= 1


def find_box(mask):
    ys, xs = np.nonzero(mask)
    if not len(ys):
        return np.zeros((0, 4))
    return np.array([[xs.min(), ys.min(), xs.max(), ys.max()]], float)


def make_frame(truths, seed):
    """Return random answers of a method with one relevancy for each object, mostly plausible."""
    rng = np.random.default_rng(seed)
    ids = np.zeros(truths[0].shape, np.int32)  # objects: the truths, grown, moved and overlapping
    for k, truth in enumerate(truths):
        moved = np.roll(truth, rng.integers(-4, 5, 2), (0, 1))
        ids[cv2.dilate(moved.view(np.uint8), np.ones((3, 3), np.uint8)) > 0] = k + 1
    table = rng.integers(1, 60, (len(truths), ids.max() + 1)) / np.float32(64)
    table[:, 0] = 0  # nothing is known there
    answers = []
    for k, scores in enumerate(table):
        scores[min(k + 1, len(scores) - 1)] += np.float32(0.0625)
        relevancy = scores[ids]
        best = relevancy == relevancy.max()
        ys, xs = np.nonzero(best)
        answers.append(Answer(relevancy, best, (int(xs[0]), int(ys[0]))))
    labels = np.where(ids > 0, table.argmax(0)[ids] + 1, 0).astype(np.int32)
    return Frame(answers, truths, [find_box(truth) for truth in truths], labels)


def drawn(polygon):
    mask = np.zeros(SHAPE, np.uint8)
    cv2.fillPoly(mask, [np.asarray(polygon, np.int32)], 1)
    return mask.astype(bool)


POLYGONS = {
    "a triangle": [(5, 5), (60, 12), (30, 45)],
    "crosses itself": [(5, 5), (60, 45), (60, 5), (5, 45)],
    "a star": [(36, 2), (48, 48), (5, 18), (68, 18), (22, 48)],
    "beyond the image": [(-40, -30), (120, 10), (50, 90), (-20, 60)],
    "outside of it": [(-40, -30), (-10, -30), (-10, -5)],
    "a hole behind a slit": [
        *((5, 5), (60, 5), (60, 45), (5, 45), (5, 5)),
        *((20, 15), (20, 35), (45, 35), (45, 15), (20, 15)),
    ],
    "a line": [(3, 3), (60, 40), (3, 3)],
    "a pixel": [(9, 9), (9, 9), (9, 9)],
    "all of it": [(0, 0), (71, 0), (71, 51), (0, 51)],
}


@pytest.mark.parametrize("name", POLYGONS)
def test_protocols_equal_plain_loops_on_polygons(name):
    rest = {"a triangle", "a star"} - {name}
    check(make_frame([drawn(POLYGONS[n]) for n in (name, *sorted(rest))], seed=0))


POINTS = st.tuples(st.integers(-30, 100), st.integers(-30, 80))


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.lists(POINTS, min_size=3, max_size=9), min_size=1, max_size=4), st.integers(0, 99)
)
def test_protocols_equal_plain_loops_on_random_polygons(polygons, seed):
    check(make_frame([drawn(polygon) for polygon in polygons], seed))


def score_one(name, relevancy, truth, mask=None, point=None):
    """Score one answer."""
    mask = relevancy > 0.5 if mask is None else mask
    frame = Frame(
        [Answer(relevancy, mask, point)], [truth], [find_box(truth)], mask.astype(np.int32)
    )
    (actual,) = scored(name, frame)
    return actual


def square(value=0.9, rest=0.1):
    relevancy = np.full((200, 260), rest, np.float32)
    relevancy[60:120, 100:170] = value
    return relevancy, relevancy == np.float32(value)


def mask_settings(name, width, **rules):
    how = load_protocol(name).mask_settings(Rules(**rules), width)
    return how.selection, how.threshold, how.share, how.filter


def test_langsplat_filter_is_30_pixels_or_a_share_of_the_width():
    for name, side in (("langsplat", 30), ("langsplat-rescaled", 8)):
        assert mask_settings(name, 260) == ("stretched", 0.4, None, side)
        mask = plain.langsplat(square()[0], side)[0]
        assert np.array_equal(score_one(name, *square()).mask, mask)
    assert mask_settings("langsplat-rescaled", 988)[3] == 30
    assert mask_settings("langsplat-rescaled", 576)[3] == 17


def test_slgaussian_protocol_states_the_rule_of_its_masks():
    assert mask_settings("slgaussian", 576, share=0.8) == ("near-best", None, 0.8, None)
    assert mask_settings("slgaussian", 576, threshold=0.6) == ("threshold", 0.6, None, None)
    relevancy, truth = square()
    half = truth.copy()
    half[:, :135] = False
    actual = score_one("slgaussian", relevancy, truth, half, (134, 90))
    assert actual.scores["iou"] == 0.5 and actual.mask is half and actual.point == (134, 90)
    assert actual.scores["hit_mask"] is True


def test_three_d_ovs_lets_absent_classes_compete():
    truth, nothing, labels = np.zeros(SHAPE, bool), np.zeros(SHAPE, bool), np.ones(SHAPE, np.int32)
    truth[:, :36] = True
    labels[:, :9] = 2
    answer = Answer(np.full(SHAPE, 0.5, np.float32), nothing, (3, 3))
    boxes = [find_box(truth), find_box(nothing)]
    present, absent = scored("3d-ovs", Frame([answer] * 2, [truth, nothing], boxes, labels))
    assert absent.scores == {} and absent.mask[:, :9].all() and present.point is None
    # Its wins are errors; and so is all of the unlabelled half.
    assert present.scores["accuracy"] == present.scores["class_iou"] == 27 / 72


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("columns", [72, 0, 36])
def test_protocols_score_a_constant_relevancy(value, columns):
    truth = np.zeros(SHAPE, bool)
    truth[:, :columns] = True
    relevancy = np.full(SHAPE, value, np.float32)
    labels = (relevancy > 0.5).astype(np.int32)
    check(Frame([Answer(relevancy, relevancy > 0.5, None)], [truth], [find_box(truth)], labels))
    literal = score_one("langsplat", relevancy, truth)
    assert not literal.mask.any()
    assert (literal.point is None) == (value == 0)


def test_langsplat_protocol_ignores_unknown_pixels():
    """Three values, 0.4 to 0.6, and a hole: the mask equals that of the image without a hole."""
    relevancy, truth = square(0.6, 0.4)
    relevancy[60:120, 200:250] = 0.5
    holed = relevancy.copy()
    holed[150:, :80] = 0
    a, b = (score_one("langsplat", image, truth) for image in (relevancy, holed))
    assert np.array_equal(a.mask, b.mask) and not a.mask[90, 225]
