"""Relevancy where it is hard to compute, and texts that are hard to read: a test a case.

Cases are those of ``tests/language/hard_texts.py``.
"""

import numpy as np
import pytest

from slgaussian.errors import InputError
from slgaussian.language.relevancy import Scorer, relevancy
from tests.language.hard_texts import (
    CLIP_TEXTS,
    JUDGED,
    TEMPERATURES,
    Case,
    case,
    clip_case,
    error,
    names,
    reference,
)

EXACT = 6e-16
"""A cosine near 1 of 512 products is off by up to 6e-16, and a relevancy by a quarter of two of
them times the temperature: measured at most 2.8e-16 times T."""

HALF = 1.2e-4
"""Times T / 4: what rounding features to half precision does to a gap; measured 7e-5."""


def within(case: Case) -> None:
    for t in TEMPERATURES:
        assert error(case, t) <= EXACT * (1 + t)
        assert error(case, t, half=True) <= HALF * t / 4


@pytest.mark.parametrize("name", names())
def test_every_case_is_within_its_bound(name):
    within(case(name))


def test_real_clip_texts_are_within_the_same_bound(real_data):
    if not (real_data / CLIP_TEXTS).is_file():
        pytest.skip(f"no {CLIP_TEXTS} in the folder of real data")
    within(clip_case(real_data))


def test_the_reference_can_tell_right_from_wrong():
    """By hand: cosines 0.6 and 0.8 against 0 at temperature 1, and an absent view."""
    features = np.array([[[0.6, 0.8], [0.8, 0.6]], [[0.6, 0.8], [1.0, 0.0]]])
    present = np.array([[True, True], [True, False]])
    query, canonical = np.array([[1.0, 0]]), np.array([[0, -1.0]])
    gaps = np.array([0.8 + 0.6, 0.6 + 0.8])
    expected = 1 / (1 + np.exp(-gaps))
    got = reference(Case(features, present, query, canonical), 1.0)[0]
    np.testing.assert_allclose(got, expected, rtol=1e-15)


@pytest.mark.parametrize("name", ["all_identical", "ten_thousand"])
def test_equal_objects_tie_to_the_last_bit_wherever_they_stand(name):
    it = case(name)
    n = len(it.features)
    # The same objects once more, in another order and in half as many rows of a longer array.
    order = np.random.default_rng(1).permutation(n)
    once = Scorer(it.features, it.present, it.canonical).gaps(it.queries)
    again = Scorer(
        np.concatenate([it.features[:7], it.features[order]]),
        np.concatenate([it.present[:7], it.present[order]]),
        it.canonical,
    ).gaps(it.queries[::-1])
    np.testing.assert_array_equal(again[::-1, 7:], once[:, order])
    if name == "all_identical":
        assert len(np.unique(once[0])) == 1


def test_a_query_that_is_a_phrase_is_never_better_than_it():
    it = case("query_is_a_phrase")
    scores = relevancy(it.features, it.present, it.queries, it.canonical, 1000.0)
    assert scores.max() == 0.5
    assert len(it.features) > JUDGED


SAME = {
    "10,000 words": "red ball " * 5_000,
    "capitals": "RED BALL",
    "not ASCII, same letters": "ｒｅｄ ｂａｌｌ",
    "a zero byte": "red\0ball",
}
REFUSED = {
    "only unseen words": "zyzzyva",
    "empty": "",
    "blank": " \t\n",
    "no letters": "!? ...",
    "one of 100,000 letters": "r" * 100_000,
    "another alphabet": "красный мяч",
    "no spaces": "赤いボール",
    "a negation": "not red",
    "a number": "2",
}


def test_the_lexicon_reads_or_refuses_every_text(lexicon):
    for name, text in SAME.items():
        vectors = lexicon.encode_text(["red ball", text])
        np.testing.assert_array_equal(*vectors, err_msg=name)
    for text, unknown in (("red zyzzyva", ("zyzzyva",)), ("red 🏀", ())):
        assert np.linalg.norm(lexicon.encode_text([text])[0]) == pytest.approx(1, abs=1e-6)
        assert lexicon.unknown_words(text) == unknown
    for name, text in REFUSED.items():
        with pytest.raises(InputError) as error:
            lexicon.encode_text([text])
        assert len(str(error.value)) < 300, name
