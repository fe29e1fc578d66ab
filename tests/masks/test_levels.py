"""Groups of objects: pieces that belong together, and properties of every level."""

import numpy as np
import pytest
from drawn_views import SIZE, canvas, paste, view
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from slgaussian.labels import LabelMaps
from slgaussian.masks.levels import CUTS, group_objects


def maps_of(labels):
    labels = np.asarray(labels, np.int32)
    return LabelMaps(labels, np.ones(labels.shape, np.float32))


@pytest.mark.parametrize("depths", [(None, None), (2.0, 2.0), (0.0, None)])
def test_pieces_of_one_object_are_one_group_and_the_wall_is_another(depths):
    """A red object in two pieces (7 and 9) on a wall (3), the second view without piece 9."""
    views, labels = [], []
    for shift, cut, depth in zip((0, 6), (80, 100), depths, strict=True):
        picture = canvas((120, 120, 120), seed=1, contrast=3.0)
        paste(picture, (40, 80, 60 + shift, 100 + shift), (190, 40, 40))
        label = np.full(SIZE, 3)
        label[40:80, 60 + shift : cut + shift] = 7
        label[40:80, cut + shift : 100 + shift] = 9
        views.append(view(picture, depth=depth))
        labels.append(label)
    maps = maps_of(labels)
    assert (maps.areas() > 0).tolist() == [[1, 1], [1, 1], [1, 0]]
    levels, groups = group_objects(views, maps)
    assert levels.dtype == np.int32 and levels.shape == (len(CUTS), 3)
    wall, left, right = levels.T
    np.testing.assert_array_equal(left, right)
    assert (wall != left).all()
    np.testing.assert_array_equal(group_objects(views, maps).levels, levels)
    # Of objects 3, 7 and 9: the pieces of the red object, and all.
    assert {tuple(row) for row in groups.members.tolist()} == {(False, True, True), (True,) * 3}
    assert groups.standing[3 + groups.members[:, 0].argmin()] > groups.standing[1:3].max()
    np.testing.assert_allclose(groups.shares, maps.areas() / maps.labels[0].size, rtol=1e-6)
    assert groups.at_edge.tolist() == [2 * 2 * sum(SIZE), 0, 0]


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.booleans())
def test_groups_of_any_image_are_connected_partitions(seed, maximum, blank):
    rng = np.random.default_rng(seed)
    picture = np.full((*SIZE, 3), 90.0) if blank else rng.uniform(0, 255, (*SIZE, 3))
    coarse = rng.integers(0, maximum + 1, (2, 6, 8)) * 10
    maps = maps_of(np.kron(coarse, np.ones((1, 20, 20), int)))
    if len(maps.ids) == 0:
        return
    views = [view(picture, depth=rng.uniform(1, 3, SIZE)), view(picture)]
    for numbers in group_objects(views, maps).levels:
        assert set(numbers) == set(range(numbers.max() + 1))
        for number in set(numbers):
            members = maps.ids[numbers == number]
            # Objects that some view shows in one patch are linked; links must join them all.
            links = np.eye(len(members), dtype=bool)
            for label in maps.labels:
                patches, count = ndimage.label(np.isin(label, members))
                for patch in range(1, count + 1):
                    inside = np.isin(members, label[patches == patch])
                    links |= np.outer(inside, inside)
                for k, member in enumerate(members):  # an object may lie in several patches
                    inside = np.isin(members, label[np.isin(patches, patches[label == member])])
                    links[k] |= inside & (label == member).any()
            assert (np.linalg.matrix_power(links.astype(float), len(members)) > 0).all()
