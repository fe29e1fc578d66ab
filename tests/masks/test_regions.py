"""The proposer ``regions``: disjoint regions by colour and depth."""

import numpy as np
import pytest
from drawn_views import SIZE, box_masks, canvas, paste, view

from slgaussian.geometry import SeenView
from slgaussian.masks.flatten import flatten
from slgaussian.masks.regions import Regions


@pytest.fixture(scope="module")
def scene():
    picture = canvas((150, 150, 150), contrast=4)
    paste(picture, (30, 70, 20, 60), (200, 40, 40))
    paste(picture, (50, 100, 90, 140), (40, 60, 190), seed=3)
    return view(picture)


def test_regions_are_disjoint_scored_and_cover_the_image(scene):
    proposals = Regions().propose(scene)
    assert (proposals.masks.sum(0) == 1).all()
    assert proposals.masks.any((1, 2)).all()
    assert proposals.scores.dtype == np.float32
    assert (proposals.scores >= 0).all() and (proposals.scores <= 1).all()


def test_region_limits_the_search(scene):
    region = np.zeros(SIZE, bool)
    region[:, 80:] = True
    proposals = Regions().propose(scene, region=region)
    np.testing.assert_array_equal(proposals.masks.any(0), region)
    empty = Regions().propose(scene, region=np.zeros(SIZE, bool))
    assert empty.masks.shape == (0, *SIZE) and empty.scores.shape == (0,)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (7, 2), (37, 51)])
@pytest.mark.parametrize("value", [0, 128, 255])
def test_blank_image_is_one_region(size, value):
    proposals = Regions().propose(SeenView.alone(np.full((*size, 3), value, np.uint8)))
    assert proposals.masks.shape == (1, *size) and proposals.masks.all()
    assert proposals.scores.tolist() == [1]


def test_depth_splits_a_surface_of_one_colour():
    picture = canvas((130, 130, 130), contrast=2)
    labels = flatten(Regions().propose(view(picture)))
    inside, above = (np.bincount(box.ravel()) for box in (labels[45:85, 55:105], labels[:30]))
    assert inside.argmax() == above.argmax()
    (box,) = box_masks([(40, 90, 50, 110)])
    masks = Regions().propose(view(picture, depth=np.where(box, 2.0, 4.0))).masks
    overlaps = (masks & box).sum((1, 2)) / (masks | box).sum((1, 2))
    assert overlaps.max() > 0.85
