"""Association of masks over views: order, replicas, votes and the match of detections."""

import numpy as np
import pytest
from drawn_views import SIZE, box_masks, canvas, paste, room, view

from slgaussian.errors import InputError
from slgaussian.masks import Proposals
from slgaussian.masks.associate import associate, match_detections
from slgaussian.masks.geometric import GeometricTracker
from slgaussian.masks.regions import Regions


class BoxProposer:
    """Proposes the boxes listed for each image, in order of the calls."""

    def __init__(self, *boxes_of_image):
        self.pending = list(boxes_of_image)

    def propose(self, frame, place=None):
        masks = box_masks(self.pending.pop(0), frame.image.shape[:2])
        return Proposals(masks, np.ones(len(masks), np.float32))


class ErodingTracker:
    """Takes one more row off its labels at every look at a frame.

    Stands for a tracker with a working memory, which re-segments its own last answer.
    """

    final = False

    def add(self, frame, labels):
        self.memory, self.looks = labels, 0

    def propagate(self, frame):
        self.looks += 1
        labels = self.memory.copy()
        labels[: self.looks] = 0
        return labels


def picture(seed=0):
    drawn = canvas((140, 140, 140), seed=seed)
    paste(drawn, (20, 60, 20, 70), (200, 40, 40), 1)
    paste(drawn, (60, 100, 90, 140), (40, 60, 200), 2)
    return drawn


FULL = (0, SIZE[0], 0, SIZE[1])


def test_no_proposals_give_no_labels():
    views = [view(picture(), depth=1), view(picture(1), "b", depth=1)]
    maps = associate(views, BoxProposer([], [], [], []), GeometricTracker())
    assert not maps.labels.any() and len(maps.ids) == 0 and (maps.margin == 1).all()


@pytest.mark.parametrize("first", [0, 1])
def test_object_in_one_view_only_keeps_an_id(first):
    second = picture()
    paste(second, (5, 35, 110, 150), (30, 200, 60), 9)
    views = [view(picture(), depth=1), view(second, "b", depth=1)]
    boxes = [FULL, (20, 60, 20, 70), (60, 100, 90, 140)]
    proposals = [boxes, [*boxes, (5, 35, 110, 150)]]
    order = [first, 1 - first]
    proposer = BoxProposer(*(proposals[k] for k in order))
    maps = associate([views[k] for k in order], proposer, GeometricTracker())
    without, labels = (maps.labels[order.index(k)] for k in (0, 1))
    assert labels[20, 130] == 4 if first == 0 else labels[20, 130] > 0
    assert not (without == labels[20, 130]).any()
    assert labels[40, 45] == without[40, 45]


def test_uncovered_pixels_are_proposed_again():
    proposer = BoxProposer([(0, 60, 0, SIZE[1])], [(60, SIZE[0], 0, SIZE[1])])
    maps = associate([view(picture(), depth=1)], proposer, GeometricTracker())
    assert (maps.labels[0][:60] == 1).all() and (maps.labels[0][60:] == 2).all()


def test_replicas_outvote_the_detection():
    maps = associate([view(picture())], BoxProposer([FULL]), ErodingTracker(), replicas=5)
    # Copy k has lost k rows: row 0 is lost in 4 of 5 copies, row 2 in 2 of 5, row 4 in none.
    assert not maps.labels[0][:2].any() and (maps.labels[0][2:] == 1).all()
    np.testing.assert_allclose(maps.margin[0][:6, 0], [0.6, 0.2, 0.2, 0.6, 1, 1], atol=1e-6)
    assert maps.computed == 5
    single = associate([view(picture())], BoxProposer([FULL]), ErodingTracker(), replicas=1)
    assert (single.labels == 1).all() and single.computed == 1


def test_votes_of_views_equal_votes_of_all_copies():
    """Ten frames, all computed, against those that can differ: for two views the same bytes."""
    frames = room(0, 3, (96, 128), 0.6)[::2]
    calls = []

    def run(votes):
        tracker = GeometricTracker()
        propagate = tracker.propagate
        tracker.propagate = lambda frame: calls.append(frame.view.name) or propagate(frame)
        return associate(frames, Regions(), tracker, 5, votes)

    subset, count = run("views"), len(calls)
    complete = run("copies")
    np.testing.assert_array_equal(subset.labels, complete.labels)
    np.testing.assert_array_equal(subset.margin, complete.margin)
    assert (complete.computed, len(calls) - count) == (5, 4 + 5)
    assert subset.computed == 2


def row(*runs):
    """One row of labels: ``row((5, 3), (0, 2))`` is three pixels of 5 and two of 0."""
    return np.repeat(*np.array(runs, np.int32).T)[None]


@pytest.mark.parametrize(
    ("carried", "detected", "expected"),
    [
        # Pieces of an object keep its id.
        (row((5, 6)), row((1, 2), (2, 2), (3, 2)), row((5, 6))),
        # Parts that flow carried are united by IoU.
        (row((5, 3), (0, 2), (7, 1)), row((1, 5), (2, 1)), row((5, 5), (7, 1))),
        # A region that is mostly unknown is new.
        (row((5, 1), (0, 5), (5, 4)), row((1, 4), (2, 2), (3, 4)), row((9, 4), (10, 2), (5, 4))),
        # A region that was known as two objects is split.
        (row((5, 3), (0, 1), (6, 4)), row((1, 8)), row((5, 4), (6, 4))),
        # Pixels that no region covers stay.
        (row((5, 1), (0, 1), (6, 1)), row((0, 3)), row((5, 1), (0, 1), (6, 1))),
        # 6 of the region's 10 pixels are 5, which has 14 more: IoU 6 / 24, so 6 keeps its id.
        (row((5, 6), (6, 4), (5, 14)), row((1, 10), (0, 14)), row((5, 6), (6, 4), (5, 14))),
        # All of 5 lies in the region, and is a fifth of it: IoU 4 / 20, a new object.
        (row((5, 4), (0, 16)), row((1, 20)), row((9, 20))),
        # 6 of the region's 10 pixels are all of 5: IoU 6 / 10, so all of it is 5.
        (row((5, 6), (6, 3), (0, 1)), row((1, 10)), row((5, 10))),
        # IoU 6 / 12 is not more than half.
        (row((5, 6), (6, 4), (5, 2)), row((1, 10), (0, 2)), row((5, 6), (6, 4), (5, 2))),
        # 7 of 10 known pixels are not nearly all of them, 8 are.
        (row((5, 7), (6, 3), (5, 9)), row((1, 10), (0, 9)), row((5, 7), (6, 3), (5, 9))),
        (row((5, 8), (6, 2), (5, 9)), row((1, 10), (0, 9)), row((5, 10), (5, 9))),
        # 7 known pixels of 20 are too few to give the region an id, 8 are enough.
        (row((5, 7), (0, 13), (5, 9)), row((1, 20), (0, 9)), row((9, 20), (5, 9))),
        (row((5, 8), (0, 12), (5, 9)), row((1, 20), (0, 9)), row((5, 20), (5, 9))),
    ],
)
def test_detections_take_ids_by_intersection_over_union(carried, detected, expected):
    assert match_detections(carried, detected, 9).tolist() == expected.tolist()


@pytest.mark.parametrize(
    ("views", "settings", "message"),
    [
        ([], {}, "no views"),
        ([view(picture())], {"replicas": 0}, "replicas"),
        ([view(picture()), view(picture()[:-1], "b")], {}, "'b'"),
    ],
)
def test_bad_input_is_refused(views, settings, message):
    with pytest.raises(InputError, match=message):
        associate(views, Regions(), GeometricTracker(), **settings)
