"""The memory bank: what it holds, what it refuses, and that absent means absent."""

from dataclasses import replace

import numpy as np
import pytest
from drawn import BLUE, RED, ball, bank_of, photograph, view_of

from slgaussian.errors import InputError
from slgaussian.labels import LabelMaps
from slgaussian.language.bank import MemoryBank, build_bank
from slgaussian.language.relevancy import relevancy


@pytest.fixture
def bank(lexicon) -> MemoryBank:
    """A red ball (id 1) in both views, a blue one (id 2) in the first alone."""
    both = photograph([(ball(80, 120, 30), RED), (ball(220, 120, 30), BLUE)])
    one = photograph([(ball(90, 120, 30), RED)])
    return bank_of([both[0], one[0]], [both[1], one[1]], lexicon)


def test_an_absent_view_is_marked_absent_and_never_scored(bank, lexicon):
    np.testing.assert_array_equal(bank.ids, [1, 2])
    np.testing.assert_array_equal(bank.present, [[True, True], [True, False]])
    assert not bank.features[1, 1].any()
    texts = lexicon.encode_text(["red"]), lexicon.encode_text(lexicon.canonical)
    scores = relevancy(bank.features, bank.present, *texts)[0]
    assert scores[0] > 0.5
    # A zero vector would have lifted this to 0.5.
    assert scores[1] < 0.5


def test_present_features_are_unit_vectors(bank):
    lengths = np.linalg.norm(bank.features, axis=2)
    np.testing.assert_allclose(lengths[bank.present], 1, atol=1e-6)


def test_arrays_round_trip(bank, tmp_path):
    np.savez(tmp_path / "bank.npz", **bank.to_arrays())
    with np.load(tmp_path / "bank.npz") as arrays:
        again = MemoryBank.from_arrays(dict(arrays))
    for name, array in bank.to_arrays().items():
        np.testing.assert_array_equal(getattr(again, name), array)


def test_damage_is_refused_by_name(bank):
    nan = bank.features.copy()
    nan[0, 1, 3] = np.nan
    long = bank.features.copy()
    long[1, 0] *= 1.1
    ghost = bank.features.copy()
    ghost[1, 1] = ghost[1, 0]
    for changes, match in (
        ({"features": nan}, "object 1 in view 1"),
        ({"features": long}, "object 2 in view 0 has length 1.1"),
        ({"features": ghost}, "object 2 in view 1 has length 1, expected 0"),
        ({"features": np.zeros_like(bank.features)}, "length 0, expected 1"),
        ({"features": bank.features.astype(np.float64)}, "float64"),
        ({"present": bank.present[:, :1]}, "present"),
        ({"codes": bank.codes * np.float32(np.nan)}, "NaN"),
        ({"codes": bank.codes + np.float32(1)}, "outside"),
        ({"codes": np.repeat(bank.codes[:1], 2, axis=0)}, "share one code"),
        ({"ids": bank.ids[::-1].copy()}, "ascending"),
        ({"ids": bank.ids - np.int32(1)}, "positive"),
    ):
        with pytest.raises(InputError, match=match):
            replace(bank, **changes)


def test_views_maps_and_codes_must_agree(bank, lexicon):
    image, ids = photograph([(ball(80, 120, 30), RED)])
    view, margin = view_of(image), np.ones((1, *ids.shape), np.float32)
    maps = LabelMaps(ids[None], margin)
    with pytest.raises(InputError, match="no object"):
        build_bank([view], LabelMaps(np.zeros_like(ids)[None], margin), lexicon, bank.codes[:0])
    with pytest.raises(InputError, match="one map"):
        build_bank([], maps, lexicon, bank.codes[:1])
    with pytest.raises(InputError, match="one map"):
        build_bank([view_of(image[1:])], maps, lexicon, bank.codes[:1])
    with pytest.raises(InputError, match="2 codes for 1 objects"):
        build_bank([view], maps, lexicon, bank.codes)
