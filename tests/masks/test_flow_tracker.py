import cv2
import numpy as np
import pytest
from drawn_views import SIZE, canvas, main_label, paste, view

from slgaussian.errors import InputError
from slgaussian.masks.flow import FlowTracker


def drawn(*objects, shift=(0, 0), background=0):
    """A textured picture with objects (box, colour, seed), all moved by (dy, dx), and its labels.

    The background is cut from a larger canvas, so that it moves too and new parts come into view.
    """
    dy, dx = shift
    large = np.tile(canvas((130, 130, 120), seed=background), (2, 2, 1))
    picture = large[60 - dy : 60 - dy + SIZE[0], 80 - dx : 80 - dx + SIZE[1]].copy()
    labels = np.ones(SIZE, np.int32)
    for index, ((top, bottom, left, right), color, seed) in enumerate(objects, start=2):
        box = (top + dy, bottom + dy, left + dx, right + dx)
        paste(picture, box, color, seed)
        labels[max(box[0], 0) : max(box[1], 0), max(box[2], 0) : max(box[3], 0)] = index
    return picture, labels


RED = ((30, 75, 20, 70), (200, 50, 40), 11)
BLUE = ((55, 100, 85, 140), (50, 60, 200), 12)


@pytest.mark.parametrize("shift", [(0, 3), (-4, 9), (6, -22)])
def test_labels_follow_a_moving_picture(shift):
    before, labels = drawn(RED, BLUE)
    after, expected = drawn(RED, BLUE, shift=shift)
    tracker = FlowTracker()
    tracker.add(view(before), labels)
    carried = tracker.propagate(view(after))
    known = carried > 0
    assert known.mean() > 0.75
    assert (carried == expected)[known].mean() > 0.95


def test_a_replica_gets_the_remembered_labels_back_exactly():
    picture, _ = drawn(RED, BLUE)
    labels = np.random.default_rng(0).integers(0, 9, SIZE).astype(np.int32)
    tracker = FlowTracker()
    tracker.add(view(picture), labels)
    other, _ = drawn(RED, shift=(2, 2))
    tracker.add(view(other), np.zeros(SIZE, np.int32))
    np.testing.assert_array_equal(tracker.propagate(view(picture.copy())), labels)
    # Of equal frames the latest counts.
    tracker.add(view(picture), labels + 1)
    np.testing.assert_array_equal(tracker.propagate(view(picture)), labels + 1)


def test_memory_is_a_copy():
    picture, labels = drawn(RED)
    tracker = FlowTracker()
    tracker.add(view(picture), labels)
    expected = labels.copy()
    labels[:] = 0
    tracker.propagate(view(picture))[:] = 0
    np.testing.assert_array_equal(tracker.propagate(view(picture)), expected)


def test_an_object_that_left_the_view_is_gone():
    leaver = ((30, 80, 0, 30), (210, 60, 40), 21)
    before, labels = drawn(leaver, BLUE)
    after, expected = drawn(leaver, BLUE, shift=(0, -34))
    assert 2 not in expected
    tracker = FlowTracker()
    tracker.add(view(before), labels)
    carried = tracker.propagate(view(after))
    assert (carried == 2).mean() < 0.002
    assert main_label(carried, (60, 95, 60, 100)) == 3


def test_two_identical_objects_side_by_side_keep_their_own_ids():
    twins = [((40, 80, left, left + 30), (200, 180, 40), 31) for left in (30, 75)]
    before, labels = drawn(*twins)
    after, _ = drawn(*twins, shift=(3, 12))
    tracker = FlowTracker()
    tracker.add(view(before), labels)
    carried = tracker.propagate(view(after))
    assert main_label(carried, (45, 80, 44, 70)) == 2
    assert main_label(carried, (45, 80, 89, 115)) == 3


def test_what_comes_into_view_wearing_new_colours_stays_unassigned():
    before, labels = drawn(RED)
    after, _ = drawn(RED, shift=(0, -10))
    paste(after, (20, 90, 150, 160), (20, 230, 60))
    tracker = FlowTracker()
    tracker.add(view(before), labels)
    assert main_label(tracker.propagate(view(after)), (25, 85, 152, 160)) == 0


def test_a_second_memory_frame_knows_what_the_first_did_not_see():
    objects = (RED, BLUE, ((20, 80, 142, 160), (60, 200, 60), 13))
    middle, expected = drawn(*objects)
    left, left_labels = drawn(*objects, shift=(0, 25))
    right, right_labels = drawn(*objects, shift=(0, -25))
    assert 4 not in left_labels and 4 in right_labels
    tracker = FlowTracker()
    tracker.add(view(left), left_labels)
    assert main_label(tracker.propagate(view(middle)), (25, 75, 145, 160)) == 0
    tracker.add(view(right), right_labels)
    carried = tracker.propagate(view(middle))
    assert main_label(carried, (25, 75, 145, 160)) == 4
    assert (carried == expected)[carried > 0].mean() > 0.95


@pytest.mark.parametrize("value", [0, 255])
def test_blank_images_do_not_break_it(value):
    tracker = FlowTracker()
    assert not tracker.propagate(view(np.full((*SIZE, 3), value))).any()  # empty memory
    tracker.add(view(np.full((*SIZE, 3), 90)), np.full(SIZE, 4, np.int32))
    carried = tracker.propagate(view(np.full((*SIZE, 3), value)))
    assert set(np.unique(carried)) <= {0, 4}


def test_same_bytes_again_and_whatever_the_number_of_threads():
    before, labels = drawn(RED, BLUE)
    after, _ = drawn(RED, BLUE, shift=(4, 14))
    threads, results = cv2.getNumThreads(), []
    try:
        for count in (1, 4, 4):
            cv2.setNumThreads(count)
            tracker = FlowTracker()
            tracker.add(view(before), labels)
            results.append(tracker.propagate(view(after)).tobytes())
    finally:
        cv2.setNumThreads(threads)
    assert len(set(results)) == 1


def test_bad_labels_are_refused():
    picture, labels = drawn(RED)
    tracker = FlowTracker()
    with pytest.raises(InputError, match="expected int32"):
        tracker.add(view(picture), labels.astype(np.int64))
    with pytest.raises(InputError, match="expected int32"):
        tracker.add(view(picture), labels[:-1])
    with pytest.raises(InputError, match="negative label"):
        tracker.add(view(picture), labels - 3)
