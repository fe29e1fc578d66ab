from functools import cache

import numpy as np
import pytest
from drawn_views import SIZE, canvas, flat, paste, view
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from slgaussian.datasets.procedural import reader
from slgaussian.errors import InputError
from slgaussian.geometry import SeenView
from slgaussian.masks import Proposals
from slgaussian.masks.associate import associate, match_detections, vote
from slgaussian.masks.geometric import GeometricTracker
from slgaussian.masks.regions import Regions


class Drawn:
    """Proposes the boxes it was given for each image, in order of the calls."""

    def __init__(self, *boxes_of_image):
        self.pending = list(boxes_of_image)

    def propose(self, frame, place=None):
        boxes = self.pending.pop(0)
        masks = np.zeros((len(boxes), *frame.image.shape[:2]), bool)
        for mask, (top, bottom, left, right) in zip(masks, boxes, strict=True):
            mask[top:bottom, left:right] = True
        return Proposals(masks, np.ones(len(boxes), np.float32))


class Wandering:
    """A tracker with a working memory: every look at a frame nibbles one more row off its labels,
    as a tracker does that re-segments its own last answer.
    """

    final = False

    def __init__(self, looks_that_differ=99):
        self.memory, self.looks, self.last = None, 0, looks_that_differ

    def add(self, frame, labels):
        self.memory, self.looks = labels, 0

    def propagate(self, frame):
        self.looks += 1
        out = self.memory.copy()
        out[: min(self.looks, self.last)] = 0
        return out


def picture(seed=0):
    drawn = canvas((140, 140, 140), seed=seed)
    paste(drawn, (20, 60, 20, 70), (200, 40, 40), 1)
    paste(drawn, (60, 100, 90, 140), (40, 60, 200), 2)
    return drawn


WHOLE = (0, *SIZE[:1], 0, *SIZE[1:])


def test_associate_without_proposals_returns_empty_labels():
    views = [flat(picture()), flat(picture(1), "b")]
    maps = associate(views, Drawn([], [], [], []), GeometricTracker())
    assert not maps.labels.any() and len(maps.ids) == 0 and (maps.margin == 1).all()


def test_associate_keeps_object_of_one_view_with_its_own_id():
    first, second = picture(), picture()
    paste(second, (5, 35, 110, 150), (30, 200, 60), 9)
    boxes = [WHOLE, (20, 60, 20, 70), (60, 100, 90, 140)]
    views = [flat(first), flat(second, "b")]
    maps = associate(views, Drawn(boxes, [*boxes, (5, 35, 110, 150)]), GeometricTracker())
    new = maps.labels[1][20, 130]
    assert new == 4 and not (maps.labels[0] == new).any()
    swapped = associate(views[::-1], Drawn([*boxes, (5, 35, 110, 150)], boxes), GeometricTracker())
    gone = swapped.labels[0][20, 130]
    assert gone > 0 and not (swapped.labels[1] == gone).any()
    for maps_of_order in (maps, swapped):
        assert (maps_of_order.labels[:, 40, 45] == maps_of_order.labels[0, 40, 45]).all()


def test_uncovered_pixels_are_proposed_a_second_time():
    drawn = Drawn([(0, 60, 0, SIZE[1])], [(60, SIZE[0], 0, SIZE[1])])
    maps = associate([flat(picture())], drawn, GeometricTracker())
    assert (maps.labels[0][:60] == 1).all() and (maps.labels[0][60:] == 2).all()


def test_majority_of_replicas_overrules_detection():
    maps = associate([view(picture())], Drawn([WHOLE]), Wandering(), replicas=5)
    # Copy k has lost k rows: row 0 is lost in 4 of 5 copies, row 2 in 2 of 5, row 4 in none.
    assert not maps.labels[0][:2].any() and (maps.labels[0][2:] == 1).all()
    np.testing.assert_allclose(maps.margin[0][:6, 0], [0.6, 0.2, 0.2, 0.6, 1, 1], atol=1e-6)
    assert maps.computed == 5
    alone = associate([view(picture())], Drawn([WHOLE]), Wandering(), replicas=1)
    assert (alone.labels == 1).all() and alone.computed == 1


@cache
def room_views(seed):
    scene = reader.read(seed, height=96, width=128, views=3, baseline=0.6)
    views = [scene.read(name) for name in scene.cameras][::2]
    return views, [SeenView(view, view.depth) for view in views]


def test_skipping_identical_copies_gives_same_labels_and_margins():
    """Ten frames, all made, against those that can differ: of two views the same bytes."""
    _, frame = room_views(0)
    calls = []

    def label(votes):
        tracker = GeometricTracker()
        propagate = tracker.propagate
        tracker.propagate = lambda here: calls.append(here.view.name) or propagate(here)
        return associate(frame, Regions(), tracker, 5, votes)

    subset, count = label("views"), len(calls)
    every = label("copies")
    np.testing.assert_array_equal(subset.labels, every.labels)
    np.testing.assert_array_equal(subset.margin, every.margin)
    assert (every.computed, len(calls) - count) == (5, 4 + 5)
    assert subset.computed == 2


def row(**lengths):
    """One row of labels: ``row(a5=3, b0=2)`` is three pixels of 5 and two of 0."""
    labels = [int(name[1:]) for name, count in lengths.items() for _ in range(count)]
    return np.array([labels], np.int32)


@pytest.mark.parametrize(
    ("carried", "detected", "expected"),
    [
        # Pieces of an object keep its id.
        (row(a5=6), row(a1=2, b2=2, c3=2), row(a5=6)),
        # What flow carried in part is united by IoU.
        (row(a5=3, b0=2, c7=1), row(a1=5, b2=1), row(a5=5, b7=1)),
        # What is mostly unknown is new.
        (row(a5=1, b0=5, c5=4), row(a1=4, b2=2, c3=4), row(a9=4, b10=2, c5=4)),
        # A region that was known as two objects is split.
        (row(a5=3, b0=1, c6=4), row(a1=8), row(a5=4, c6=4)),
        # What no region covers stays.
        (row(a5=1, b0=1, c6=1), row(a0=3), row(a5=1, b0=1, c6=1)),
        # 6 of its 10 pixels are 5, which has 14 more: IoU 6 / 24, so 6 keeps its own.
        (row(a5=6, b6=4, c5=14), row(a1=10, b0=14), row(a5=6, b6=4, c5=14)),
        # 5 lies in it whole, and is a fifth of it: IoU 4 / 20, a new object.
        (row(a5=4, b0=16), row(a1=20), row(a9=20)),
        # 6 of its 10 pixels are the whole of 5: IoU 6 / 10, so all of it is 5.
        (row(a5=6, b6=3, c0=1), row(a1=10), row(a5=10)),
        # IoU 6 / 12 is not more than half.
        (row(a5=6, b6=4, c5=2), row(a1=10, b0=2), row(a5=6, b6=4, c5=2)),
        # 7 of 10 known pixels are not nearly all of them, 8 are.
        (row(a5=7, b6=3, c5=9), row(a1=10, b0=9), row(a5=7, b6=3, c5=9)),
        (row(a5=8, b6=2, c5=9), row(a1=10, b0=9), row(a5=10, c5=9)),
        # 7 of 20 pixels are too few to know it by, 8 will do.
        (row(a5=7, b0=13, c5=9), row(a1=20, b0=9), row(a9=20, c5=9)),
        (row(a5=8, b0=12, c5=9), row(a1=20, b0=9), row(a5=20, c5=9)),
    ],
)
def test_match_detections_assigns_ids_by_iou_and_known_pixels(carried, detected, expected):
    assert match_detections(carried, detected, 9).tolist() == expected.tolist()


@pytest.mark.parametrize(
    ("views", "settings", "says"),
    [
        ([], {}, "no views"),
        ([view(picture())], {"replicas": 0}, "replicas"),
        ([view(picture()), view(picture()[:-1], "b")], {}, "'b'"),
    ],
)
def test_associate_refuses_no_views_bad_replicas_and_mixed_sizes(views, settings, says):
    with pytest.raises(InputError, match=says):
        associate(views, Regions(), GeometricTracker(), **settings)


def plain_vote(stack):
    """The rule, written as loops over pixels and replicas."""
    labels = np.zeros(stack.shape[1:], np.int32)
    margin = np.zeros(stack.shape[1:])
    for pixel in np.ndindex(labels.shape):
        ballots = [int(replica[pixel]) for replica in stack]
        counts = {label: ballots.count(label) for label in ballots}
        winner = max(ballots, key=lambda label: counts[label])  # max keeps the first of equals
        won = counts.pop(winner)
        labels[pixel] = winner
        margin[pixel] = (won - max(counts.values(), default=0)) / len(ballots)
    return labels, margin


stacks = hnp.arrays(
    np.int32,
    st.tuples(st.integers(1, 7), st.integers(1, 3), st.integers(1, 4)),
    elements=st.integers(0, 4),
)


@given(stacks)
def test_vote_equals_plain_majority(stack):
    labels, margin = vote(stack)
    expected_labels, expected_margin = plain_vote(stack)
    np.testing.assert_array_equal(labels, expected_labels)
    np.testing.assert_allclose(margin, expected_margin, atol=1e-7)  # one float32 rounding of [0, 1]
    assert labels.dtype == np.int32 and margin.dtype == np.float32


@given(stacks, st.lists(st.integers(1, 4), min_size=7, max_size=7))
def test_map_with_weight_counts_as_many_equal_maps(stack, times):
    times = times[: len(stack)]
    labels, margin = vote(stack, times)
    expected, won = vote(np.repeat(stack, times, 0))
    np.testing.assert_array_equal(labels, expected)
    np.testing.assert_array_equal(margin, won)
