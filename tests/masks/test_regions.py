import numpy as np
import pytest
from drawn_views import SIZE, canvas, main_label, paste, view

from slgaussian.geometry import SeenView
from slgaussian.masks.flatten import flatten
from slgaussian.masks.regions import Regions

BALL = (30, 70, 20, 60)
BOX = (50, 100, 90, 140)


@pytest.fixture(scope="module")
def scene():
    picture = canvas((150, 150, 150), contrast=4)
    paste(picture, BALL, (200, 40, 40))
    paste(picture, BOX, (40, 60, 190), seed=3)
    return view(picture).image


def iou(mask, box):
    truth = np.zeros(mask.shape, bool)
    truth[box[0] : box[1], box[2] : box[3]] = True
    return (mask & truth).sum() / (mask | truth).sum()


def test_masks_are_disjoint_cover_image_and_have_scores(scene):
    proposals = Regions().propose(SeenView.alone(scene))
    assert (proposals.masks.sum(0) == 1).all()
    assert proposals.masks.any((1, 2)).all()
    assert proposals.scores.dtype == np.float32
    assert (proposals.scores >= 0).all() and (proposals.scores <= 1).all()


def test_propose_covers_only_given_region(scene):
    place = np.zeros(SIZE, bool)
    place[:, 80:] = True
    proposals = Regions().propose(SeenView.alone(scene), region=place)
    np.testing.assert_array_equal(proposals.masks.any(0), place)
    nothing = Regions().propose(SeenView.alone(scene), region=np.zeros(SIZE, bool))
    assert nothing.masks.shape == (0, *SIZE) and nothing.scores.shape == (0,)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (7, 2), (37, 51)])
@pytest.mark.parametrize("value", [0, 128, 255])
def test_blank_image_is_one_region(size, value):
    proposals = Regions().propose(SeenView.alone(np.full((*size, 3), value, np.uint8)))
    assert proposals.masks.shape == (1, *size) and proposals.masks.all()
    assert proposals.scores.tolist() == [1]


def test_depth_splits_objects_of_one_colour():
    image = view(canvas((130, 130, 130), contrast=2)).image
    depth = np.full(SIZE, 4.0, np.float32)
    depth[40:90, 50:110] = 2.0
    flat = flatten(Regions().propose(SeenView.alone(image)))
    assert main_label(flat, (45, 85, 55, 105)) == main_label(flat, (0, 30, 0, 160))
    deep = Regions().propose(SeenView.alone(image, depth))
    assert max(iou(mask, (40, 90, 50, 110)) for mask in deep.masks) > 0.85
