"""The memory bank: content, refusals, and absent objects."""

from dataclasses import fields, replace

import numpy as np
import pytest
from drawn import BLUE, RED, ball, make_bank, make_view, photograph, relevancy

from slgaussian.errors import InputError
from slgaussian.geometry import SeenView
from slgaussian.labels import LabelMaps
from slgaussian.language.bank import MemoryBank, build_bank
from slgaussian.masks.levels import group_objects
from slgaussian.storage.specs import load_spec


@pytest.fixture
def bank(lexicon) -> MemoryBank:
    """A red ball (id 1) in both views, a blue one (id 2) in the first alone."""
    both = photograph([(ball(80, 120, 30), RED), (ball(220, 120, 30), BLUE)])
    one = photograph([(ball(90, 120, 30), RED)])
    return make_bank([both[0], one[0]], [both[1], one[1]], lexicon)


def test_build_bank_marks_absent_views(bank, lexicon):
    np.testing.assert_array_equal(bank.ids, [1, 2])
    np.testing.assert_array_equal(bank.present, [[True, True], [True, False]])
    assert not bank.features[1, 1].any()
    texts = lexicon.encode_text(["red"]), lexicon.encode_text(lexicon.canonical)
    scores = relevancy(bank.features, bank.present, *texts)[0]
    assert scores[0] > 0.5
    # A zero vector would have lifted this to 0.5.
    assert scores[1] < 0.5


def compare_banks(one, other):
    for field in fields(MemoryBank):
        left, right = getattr(one, field.name), getattr(other, field.name)
        assert (left is None) == (right is None)
        if right is not None and field.name != "wholes":
            assert left.dtype == right.dtype
            np.testing.assert_array_equal(left, right)


def test_build_bank_raises_input_error_for_views_without_maps(bank, lexicon):
    image, ids = photograph([(ball(80, 120, 30), RED)])
    view, margin = make_view(image), np.ones((1, *ids.shape), np.float32)
    maps = LabelMaps(ids[None], margin)
    with pytest.raises(InputError, match="no object"):
        build_bank([view], LabelMaps(np.zeros_like(ids)[None], margin), lexicon, bank.codes[:0])
    with pytest.raises(InputError, match="one map"):
        build_bank([], maps, lexicon, bank.codes[:1])
    with pytest.raises(InputError, match="one map"):
        build_bank([make_view(image[1:])], maps, lexicon, bank.codes[:1])


@pytest.fixture(scope="module")
def pieces():
    """A red ball in quarters (ids 2 to 5; 5 in the first view only) and a blue one (7)."""
    image, labels = photograph([(ball(90, 120, 40), RED), (ball(230, 120, 30), BLUE)])
    y, x = np.mgrid[: labels.shape[0], : labels.shape[1]]
    quarter = 2 + (x > 90) + 2 * (y > 120)
    first = np.where(labels == 1, quarter, np.where(labels == 2, 7, 0)).astype(np.int32)
    second = np.where(first == 5, 4, first)
    groups = np.array([[0, 0, 0, 0, 1], [1, 1, 0, 0, 2], [4, 4, 4, 4, 2]])
    maps = LabelMaps(np.stack([first, second]), np.ones((2, *labels.shape), np.float32))
    return [make_view(image), make_view(image)], maps, groups, (labels == 1)


def build_grouped_bank(pieces, lexicon, **changes):
    views, maps, groups, _ = pieces
    codes = np.linspace(0.1, 0.9, 15).reshape(5, 3)
    arrays = {"groups": groups} | changes
    return build_bank(views, maps, lexicon, codes, **arrays)


def test_arrays_round_trip(pieces, lexicon, tmp_path):
    """Features that are stored in half precision equal the built ones, to the last bit."""
    views, maps, _, _ = pieces
    wholes = group_objects([SeenView(view) for view in views], maps).wholes
    bank = build_grouped_bank(pieces, lexicon, wholes=wholes)
    arrays = bank.to_arrays()
    load_spec("bank").check_arrays(arrays, "bank.npz")
    np.savez(tmp_path / "bank.npz", **arrays)
    with np.load(tmp_path / "bank.npz") as stored:
        assert stored["features"].dtype == stored["group_features"].dtype == np.float16
        restored = MemoryBank.from_arrays(dict(stored))
    compare_banks(restored, bank)
    for name, array in wholes.to_arrays().items():
        np.testing.assert_array_equal(restored.wholes.to_arrays()[name], array)


def test_build_bank_encodes_groups_as_unions(pieces, lexicon):
    views, _, _, labels = pieces
    bank = build_grouped_bank(pieces, lexicon)
    # Of the whole ball in two levels there is one group, and of a group of one object none.
    np.testing.assert_array_equal(bank.levels, [[5, 5, 5, 5, 4], [7, 7, 6, 6, 4], [5, 5, 5, 5, 4]])
    expected = lexicon.encode_regions(views[0].image, labels[None])[0]
    np.testing.assert_allclose(bank.group_features[0], [expected] * 2, atol=2**-11)
    features, present = bank.nodes
    assert features.shape[:2] == present.shape == (8, 2)
    assert present[5:].all() and not present[3, 1]
    # Without groups, all else is the same.
    bare = build_grouped_bank(pieces, lexicon, groups=None)
    compare_banks(replace(bank, levels=None, group_features=None), bare)
    assert bare.nodes[0] is bare.features
    alone = build_grouped_bank(pieces, lexicon, groups=np.arange(5)[None])
    np.testing.assert_array_equal(alone.levels, [np.arange(5)])
    assert alone.group_features.shape == (0, 2, lexicon.width)


def test_invalid_bank_raises_input_error_with_its_name(bank, pieces, lexicon):
    nan, long, ghost = (bank.features.copy() for _ in range(3))
    nan[0, 1, 3] = np.nan
    long[1, 0] *= 1.1
    ghost[1, 1] = ghost[1, 0]
    grouped = build_grouped_bank(pieces, lexicon)
    beyond, changed = grouped.levels.copy(), grouped.levels.copy()
    beyond[0, 0], changed[0, 0] = 8, 1
    for valid, changes, match in (
        (bank, {"features": nan}, "object 1 in view 1"),
        (bank, {"features": long}, "object 2 in view 0 has length 1.1"),
        (bank, {"features": ghost}, "object 2 in view 1 has length 1, expected 0"),
        (bank, {"features": np.zeros_like(bank.features)}, "length 0, expected 1"),
        (bank, {"codes": bank.codes * np.float32(np.nan)}, "NaN"),
        (bank, {"codes": bank.codes + np.float32(1)}, "outside"),
        (bank, {"codes": np.repeat(bank.codes[:1], 2, axis=0)}, "share one code"),
        (bank, {"ids": bank.ids[::-1].copy()}, "ascending"),
        (bank, {"ids": bank.ids - np.int32(1)}, "positive"),
        (grouped, {"levels": None}, "go together"),
        (grouped, {"levels": beyond}, "one of the 3 groups, 5 to 7"),
        (grouped, {"levels": changed}, "own row"),
        (grouped, {"group_features": grouped.group_features * 2}, "group 0 in view 0 has length 2"),
        (grouped, {"group_features": grouped.group_features * np.float32(np.nan)}, "group 0 in"),
    ):
        with pytest.raises(InputError, match=match):
            replace(valid, **changes)
