import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from slgaussian.masks import Proposals
from slgaussian.masks.flatten import flatten, remove_crumbs


def rectangles(*boxes, scores=None, size=(8, 10)):
    masks = np.zeros((len(boxes), *size), bool)
    for mask, (top, bottom, left, right) in zip(masks, boxes, strict=True):
        mask[top:bottom, left:right] = True
    scores = np.ones(len(boxes)) if scores is None else scores
    return Proposals(masks, np.asarray(scores, np.float32))


def test_flatten_puts_better_scored_of_equally_large_masks_on_top():
    boxes = ((0, 4, 0, 4), (2, 6, 0, 4))
    assert flatten(rectangles(*boxes, scores=(0.9, 0.1)))[3, 0] == 2
    assert (flatten(rectangles(*boxes, scores=(0.9, 0.1))) == 2)[0:4, 0:4].all()
    assert (flatten(rectangles(*boxes, scores=(0.1, 0.9))) == 2)[2:6, 0:4].all()
    assert (flatten(rectangles(*boxes)) == 2)[0:4, 0:4].all()  # equal scores: the earlier one


@given(
    hnp.arrays(bool, st.tuples(st.integers(0, 5), st.integers(1, 6), st.integers(1, 6))),
    st.integers(0, 2**32 - 1),
)
def test_flatten_covers_union_without_gaps_in_any_order_of_masks(masks, seed):
    areas_differ = np.argsort(np.random.default_rng(seed).random(len(masks)))
    proposals = Proposals(masks, np.linspace(0, 1, len(masks), dtype=np.float32))
    labels = flatten(proposals)
    np.testing.assert_array_equal(labels > 0, masks.any(0))
    assert set(np.unique(labels)) - {0} == set(range(1, labels.max(initial=0) + 1))
    shuffled = Proposals(masks[areas_differ], proposals.scores[areas_differ])
    np.testing.assert_array_equal(flatten(shuffled), labels)  # scores differ: no ties by index


def test_crumbs_and_small_holes_take_label_of_nearest_piece():
    labels = np.ones((100, 160), np.int32)  # a crumb is under 2 pixels here
    labels[:, 80:] = 2
    labels[50, 20] = 3
    labels[10, 100] = 0
    labels[60:62, 30] = 4  # two pixels: a piece
    labels[80, 120] = 1  # also of a label that has a large piece elsewhere
    clean = remove_crumbs(labels)
    assert clean[50, 20] == 1 and clean[10, 100] == 2 and (clean[60:62, 30] == 4).all()
    assert clean[80, 120] == 2 and (clean != labels).sum() == 3


def test_image_of_crumbs_alone_does_not_change():
    labels = np.arange(1, 90001, dtype=np.int32).reshape(300, 300)
    np.testing.assert_array_equal(remove_crumbs(labels), labels)
