"""Groups of objects: membership, and invariants of a level."""

import numpy as np
import pytest
from drawn_views import SIZE, canvas, paste, view, with_depths
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from slgaussian.labels import LabelMaps
from slgaussian.masks.levels import CUTS, group_objects


def with_depth(observed, depths):
    return with_depths([first.view for first in observed], depths)


def make_maps(*labels):
    labels = np.stack(labels).astype(np.int32)
    return LabelMaps(labels, np.ones(labels.shape, np.float32))


@pytest.fixture(scope="module")
def halves():
    """A red thing in two pieces (7 and 9) on a wall (3), the second view without piece 9."""
    pictures, labels = [], []
    for shift, cut in ((0, 80), (6, 101)):
        picture = canvas((120, 120, 120), seed=1, contrast=3.0)
        paste(picture, (40, 80, 60 + shift, 100 + shift), (190, 40, 40))
        label = np.full(SIZE, 3)
        label[40:80, 60 + shift : min(cut, 100) + shift] = 7
        label[40:80, min(cut, 100) + shift : 100 + shift] = 9
        pictures.append(view(picture))
        labels.append(label)
    return pictures, make_maps(*labels)


def test_group_objects_joins_pieces_of_one_thing_and_not_the_wall(halves):
    views, maps = halves
    assert (maps.areas() > 0).tolist() == [[1, 1], [1, 1], [1, 0]]
    flat = np.full(SIZE, 2.0, np.float32)
    for depths in ([None, None], [flat, flat], [np.zeros_like(flat), None]):
        levels, wholes = group_objects(with_depth(views, depths), maps)
        assert levels.dtype == np.int32 and levels.shape == (len(CUTS), 3)
        wall, left, right = levels.T
        np.testing.assert_array_equal(left, right)
        assert (wall != left).all()
        np.testing.assert_array_equal(group_objects(with_depth(views, depths), maps).levels, levels)
        # Of objects 3, 7 and 9: the pieces of the red thing, and all.
        assert {tuple(row) for row in wholes.members.tolist()} == {(False, True, True), (True,) * 3}
        assert wholes.standing[3 + wholes.members[:, 0].argmin()] > wholes.standing[1:3].max()
        np.testing.assert_allclose(wholes.shares, maps.areas() / maps.labels[0].size, rtol=1e-6)
        assert wholes.at_edge.tolist() == [2 * 2 * sum(SIZE), 0, 0]


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.booleans())
def test_groups_of_random_labels_are_connected_partitions(seed, maximum, blank):
    rng = np.random.default_rng(seed)
    picture = np.full((*SIZE, 3), 90.0) if blank else rng.uniform(0, 255, (*SIZE, 3))
    coarse = rng.integers(0, maximum + 1, (2, 6, 8)) * 10
    labels = np.kron(coarse, np.ones((1, 20, 20), int))
    maps = make_maps(*labels)
    if len(maps.ids) == 0:
        return
    depth = rng.uniform(1, 3, SIZE).astype(np.float32)
    levels = group_objects(with_depth([view(picture)] * 2, [depth, None]), maps).levels
    for numbers in levels:
        assert set(numbers) == set(range(numbers.max() + 1))
        for number in set(numbers):
            fixed = maps.ids[numbers == number]
            # Objects that some view shows in one patch are linked; links must join them all.
            link = np.eye(len(fixed), dtype=bool)
            for label in maps.labels:
                patches, count = ndimage.label(np.isin(label, fixed))
                for patch in range(1, count + 1):
                    inside = np.isin(fixed, label[patches == patch])
                    link |= np.outer(inside, inside)
                for k, name in enumerate(fixed):  # an object may lie in several patches
                    inside = np.isin(fixed, label[np.isin(patches, patches[label == name])])
                    link[k] |= inside & (label == name).any()
            reach = np.linalg.matrix_power(link.astype(float), len(fixed)) > 0
            assert reach.all()
