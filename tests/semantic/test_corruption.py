"""Corrupted labels are wrong in the ways they say, and nowhere else."""

import numpy as np
import pytest
from drawn_lessons import lesson
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.semantic.corruption import KINDS, corrupt


@given(st.integers(0, 2**32 - 1), st.sampled_from(sorted(KINDS)))
def test_each_object_is_harmed_in_one_view_at_most(seed, kind):
    labels = lesson().labels
    before = labels.copy()
    found = corrupt(labels, np.random.default_rng(seed), 0.5, (kind,))
    np.testing.assert_array_equal(labels, before)
    harmed = [np.unique(view[view != now]) for view, now in zip(labels, found, strict=True)]
    assert len(np.intersect1d(*harmed)) == 0


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_seed_harms_the_same(kind):
    labels = lesson().labels
    one, other = (corrupt(labels, np.random.default_rng(5), 1.0, (kind,)) for _ in range(2))
    np.testing.assert_array_equal(one, other)
    assert (one != labels).any()
    untouched = corrupt(labels, np.random.default_rng(5), 0.0, (kind,))
    np.testing.assert_array_equal(untouched, labels)


def one_disc() -> np.ndarray:
    """An object 2 amid an object 1, in two views."""
    y, x = np.mgrid[:60, :60]
    return np.stack([1 + ((x - 30) ** 2 + (y - 30) ** 2 < 200)] * 2).astype(np.int32)


def harmed(kind: str) -> np.ndarray:
    labels = one_disc()
    KINDS[kind](labels, 1, 2, np.random.default_rng(0))
    np.testing.assert_array_equal(labels[0], one_disc()[0])
    return labels[1]


def test_the_kinds_do_what_they_say():
    disc = one_disc()[1] == 2
    np.testing.assert_array_equal(harmed("missing"), np.where(disc, 0, 1))
    np.testing.assert_array_equal(harmed("wrong id"), np.where(disc, 3, 1))
    np.testing.assert_array_equal(harmed("merged"), np.ones((60, 60)))
    rim = harmed("eroded")
    assert (rim[~disc] == 1).all()
    assert 0 < np.count_nonzero(rim == 0) < 0.5 * disc.sum()
    assert rim[30, 30] == 2


def test_an_object_without_neighbours_cannot_be_merged():
    labels = np.where(one_disc() == 2, 2, 0).astype(np.int32)
    before = labels.copy()
    KINDS["merged"](labels, 1, 2, np.random.default_rng(0))
    np.testing.assert_array_equal(labels, before)
