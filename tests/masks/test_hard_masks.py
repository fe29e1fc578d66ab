"""Hard cases of the mask stage, from proposals to label maps, by the trackers that need no weights.

Views that differ in size, and id maps with holes, are also in the tests of each tracker.
"""

import numpy as np
import pytest
from drawn_views import SIZE, canvas, main_label, paste, with_depths

from slgaussian.masks import Proposals, load_tracker
from slgaussian.masks.associate import associate, match_detections
from slgaussian.masks.flatten import flatten
from slgaussian.scene import Camera, View

WHOLE = (0, SIZE[0], 0, SIZE[1])


class Drawn:
    """Proposes for each image the boxes it was given for it, and nothing a second time."""

    def __init__(self, *views_and_boxes):
        self.boxes = {view.image.tobytes(): boxes for view, boxes in views_and_boxes}

    def propose(self, frame, place=None):
        boxes = [] if place is not None else self.boxes[frame.image.tobytes()]
        masks = np.zeros((len(boxes), *frame.image.shape[:2]), bool)
        for mask, (top, bottom, left, right) in zip(masks, boxes, strict=True):
            mask[max(top, 0) : bottom, max(left, 0) : right] = True
        return Proposals(masks, np.ones(len(boxes), np.float32))


RED = ((30, 75, 30, 70), (200, 50, 40), 11)
BLUE = ((55, 100, 85, 140), (50, 60, 200), 12)
MOVE = 14
"""Pixels that the second camera went to the right by, of the motion of depth 1."""


def scene(things):
    """Two views of a wall at depth 1 with (box, colour, seed) on it, and their proposals."""
    views, boxes = [], []
    K = np.array([[100, 0, SIZE[1] / 2], [0, 100, SIZE[0] / 2], [0, 0, 1.0]])
    large = np.tile(canvas((130, 130, 120), seed=3), (2, 2, 1))
    for name, dx in (("a", 0), ("b", MOVE)):
        picture = large[50 : 50 + SIZE[0], 70 + dx : 70 + dx + SIZE[1]].copy()
        local = [WHOLE]
        for (top, bottom, left, right), color, seed in things:
            local.append((top, bottom, left - dx, right - dx))
            paste(picture, local[-1], color, seed)
        c2w = np.eye(4)
        c2w[0, 3] = dx / 100
        image = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
        views.append(View(name, Camera(K, c2w, SIZE[1], SIZE[0]), image))
        boxes.append(local)
    proposer = Drawn(*zip(views, boxes, strict=True))
    return with_depths(views, [np.ones(SIZE, np.float32)] * 2), proposer


def run(things, swapped=False):
    views, proposer = scene(things)
    order = -1 if swapped else 1
    maps = associate(views[::order], proposer, load_tracker("geometric"))
    return maps, maps.labels[::order]


@pytest.mark.parametrize("swapped", [False, True])
def test_swapped_views_find_the_same_objects(swapped):
    maps, labels = run([RED, BLUE], swapped=swapped)
    assert maps.ids.tolist() == [1, 2, 3] and len(maps.seen_once) == 0
    ids = [main_label(labels[0], box) for box in (WHOLE, RED[0], BLUE[0])]
    for (top, bottom, left, right), number in zip((RED[0], BLUE[0]), ids[1:], strict=True):
        assert (labels[0][top:bottom, left:right] == number).all()
        assert (labels[1][top:bottom, left - 14 : right - 14] == number).all()
    # Ids count by falling area in the first view of the sequence: the wall, blue, red.
    assert ids == [1, 3, 2]


def test_two_identical_objects_side_by_side_keep_their_own_ids():
    twins = [((40, 80, left, left + 28), (200, 180, 40), 31) for left in (40, 72)]
    maps, labels = run(twins)
    ids = [main_label(labels[0], box) for box, *_ in twins]
    assert len(set(ids)) == 2 and len(maps.ids) == 3
    assert ids == [main_label(labels[1], (40, 80, left, left + 28)) for left in (26, 58)]


def test_no_mask_in_one_view_or_in_none():
    views, _ = scene([RED])
    nothing = Drawn(*((v, []) for v in views))
    maps = associate(views, nothing, load_tracker("geometric"))
    assert not maps.labels.any() and len(maps.ids) == len(maps.seen_once) == 0
    assert maps.areas().shape == (0, 2)
    first = Drawn((views[0], [WHOLE, RED[0]]), (views[1], []))
    maps = associate(views, first, load_tracker("geometric"))
    # What was propagated stays, though nothing was detected.
    assert main_label(maps.labels[1], (30, 75, 16, 56)) == main_label(maps.labels[0], RED[0]) > 0
    last = Drawn((views[0], []), (views[1], [WHOLE]))
    maps = associate(views, last, load_tracker("geometric"))
    assert maps.seen_once.tolist() == [1] and not maps.labels[0].any()


def test_one_pixel_masks_come_through_every_step_unharmed():
    pixels = np.zeros((3, *SIZE), bool)
    pixels[0] = True
    pixels[1, 5, 5] = pixels[2, 119, 159] = True
    labels = flatten(Proposals(pixels, np.ones(3, np.float32)))
    assert sorted(np.unique(labels, return_counts=True)[1]) == [1, 1, SIZE[0] * SIZE[1] - 2]
    views, _ = scene([RED])
    tracker = load_tracker("geometric")
    tracker.add(views[0], labels)
    assert set(np.unique(tracker.propagate(views[1]))) <= {0, 1, 2, 3}
    assert match_detections(labels, labels, 9).tolist() == labels.tolist()
    specks = Drawn(*((v, [WHOLE, (50, 51, 50, 51)]) for v in views))
    maps = associate(views, specks, load_tracker("geometric"))
    assert maps.ids.tolist() == [1]  # a crumb: see flatten
