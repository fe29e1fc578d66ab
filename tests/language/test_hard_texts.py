"""Relevancy where it is hard to compute, and texts that are hard to read.

Errors are absolute differences of relevancies from the printed formula in decimal arithmetic of 60
digits.
"""

from dataclasses import dataclass, replace
from decimal import Context, Decimal, localcontext
from pathlib import Path

import numpy as np
import pytest
from drawn import relevancy

from slgaussian.errors import InputError
from slgaussian.language.relevancy import Scorer

TEMPERATURES = (1.0, 10.0, 100.0, 1000.0)
JUDGED = 12
"""Objects of a case, spread over all, that the slow reference is asked about."""

CLIP_TEXTS = Path("clip_text/lvis_names_clip_text.npz")
"""``names`` and unit CLIP text vectors ``features`` [Q, 512] of them, in a folder of real data."""

EXACT = 6e-16
"""A cosine near 1 of 512 products is off by up to 6e-16, and a relevancy by a quarter of two of
them times the temperature: measured at most 2.8e-16 times T."""

HALF = 1.2e-4
"""Times T / 4: what rounding features to half precision does to a gap; measured 7e-5."""


@dataclass(frozen=True)
class Case:
    """Arguments of :func:`slgaussian.language.relevancy.relevancy`, in float64."""

    features: np.ndarray
    present: np.ndarray
    queries: np.ndarray
    canonical: np.ndarray


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def random_case(n: int, width: int = 512) -> Case:
    """Objects in one or two views, whose cosines with all texts are near 0."""
    rng = np.random.default_rng(0)
    features = unit(rng.normal(size=(n, 2, width)))
    queries, canonical = unit(rng.normal(size=(3, width))), unit(rng.normal(size=(4, width)))
    present = rng.random((n, 2)) < 0.7
    present[~present.any(1), 0] = True
    return Case(features, present, queries, canonical)


def turned(vector: np.ndarray, angles: np.ndarray, seed: int) -> np.ndarray:
    """Unit vectors at ``angles`` from a unit vector, each in another direction."""
    aside = np.random.default_rng(seed).normal(size=(len(angles), len(vector)))
    aside = unit(aside - (aside @ vector)[:, None] * vector)
    return np.cos(angles)[:, None] * vector + np.sin(angles)[:, None] * aside


def hard_cases() -> dict[str, Case]:
    usual, few = random_case(60), random_case(40)
    # Objects, queries and phrases within 1e-7 to 0.01 of one direction.
    near = [
        turned(few.queries[0], np.geomspace(1e-7, 1e-2, count), seed)
        for seed, count in enumerate((80, 3, 4))
    ]
    alike = Case(near[0].reshape(40, 2, -1), few.present, near[1], near[2])
    # All cosines between 0.6 and 0.9, as CLIP has them.
    cone = (
        unit(unit(np.ones(512)) + 0.6 * vectors)
        for vectors in (usual.features, usual.queries, usual.canonical)
    )
    features, queries, canonical = cone
    one = np.ones((1, 1))
    return {
        "random directions": usual,
        "cosines near 1": alike,
        "cosines near -1": replace(alike, features=-alike.features),
        "a query and its opposite": replace(alike, canonical=-alike.canonical),
        "a narrow cone": Case(features, usual.present, queries, canonical),
        "all identical": replace(usual, features=np.tile(usual.features[:1, :1], (60, 2, 1))),
        "a query is a phrase": replace(usual, queries=usual.canonical[:3]),
        "one object": Case(one[None], np.ones((1, 1), bool), one, -one),
        "ten thousand": random_case(10_000, width=64),
    }


CASES = hard_cases()


def reference(case: Case, temperature: float) -> np.ndarray:
    """The printed formula, float64 [Q, N], with the vectors' lengths made 1."""
    with localcontext(Context(prec=60, Emin=-(10**9), Emax=10**9)):
        t = Decimal(temperature)
        texts = [_decimals(v) for v in (*case.queries, *case.canonical)]
        queries, canonical = texts[: len(case.queries)], texts[len(case.queries) :]
        out = np.zeros((len(queries), len(case.features)))
        for n, (views, held) in enumerate(zip(case.features, case.present, strict=True)):
            scores = [Decimal(0)] * len(queries)
            for view in (_decimals(v) for v, h in zip(views, held, strict=True) if h):
                phrases = [(t * _dot(view, c)).exp() for c in canonical]
                for q, query in enumerate(queries):
                    mine = (t * _dot(view, query)).exp()
                    scores[q] = max(scores[q], min(mine / (mine + other) for other in phrases))
            out[:, n] = [float(score) for score in scores]
        return out


def _decimals(vector: np.ndarray) -> list[Decimal]:
    exact = [Decimal(float(x)) for x in vector]
    length = _dot(exact, exact).sqrt()
    return [x / length for x in exact]


def _dot(a: list[Decimal], b: list[Decimal]) -> Decimal:
    return sum((x * y for x, y in zip(a, b, strict=True)), Decimal(0))


def within(case: Case) -> None:
    """Every relevancy is right, and with features in half precision nearly so."""
    picked = np.unique(np.linspace(0, len(case.features) - 1, JUDGED).astype(int))
    case = replace(case, features=case.features[picked], present=case.present[picked])
    others = case.present, case.queries, case.canonical
    for t in TEMPERATURES:
        expected = reference(case, t)
        assert np.abs(relevancy(case.features, *others, t) - expected).max() <= EXACT * (1 + t)
        half = relevancy(case.features.astype(np.float16), *others, t)
        assert np.abs(half - expected).max() <= HALF * t / 4


@pytest.mark.parametrize("name", CASES)
def test_every_case_is_within_its_bound(name):
    within(CASES[name])


def test_real_clip_texts_are_within_the_same_bound(real_data):
    """60 objects between two names each, 3 queries, 4 phrases."""
    if not (real_data / CLIP_TEXTS).is_file():
        pytest.skip(f"no {CLIP_TEXTS} in the folder of real data")
    with np.load(real_data / CLIP_TEXTS) as file:
        texts = unit(file["features"].astype(np.float64))
    texts = texts[np.random.default_rng(0).permutation(len(texts))]
    # The file is in half precision; means of two are not.
    objects = unit(texts[:60] + texts[60:120])[:, None]
    within(Case(objects, np.ones((60, 1), bool), texts[120:123], texts[123:127]))


def test_the_reference_can_tell_right_from_wrong():
    """By hand: cosines 0.6 and 0.8 against 0 at temperature 1, and an absent view."""
    features = np.array([[[0.6, 0.8], [0.8, 0.6]], [[0.6, 0.8], [1.0, 0.0]]])
    present = np.array([[True, True], [True, False]])
    query, canonical = np.array([[1.0, 0]]), np.array([[0, -1.0]])
    gaps = np.array([0.8 + 0.6, 0.6 + 0.8])
    expected = 1 / (1 + np.exp(-gaps))
    got = reference(Case(features, present, query, canonical), 1.0)[0]
    np.testing.assert_allclose(got, expected, rtol=1e-15)


@pytest.mark.parametrize("name", ["all identical", "ten thousand"])
def test_equal_objects_tie_to_the_last_bit_wherever_they_stand(name):
    it = CASES[name]
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
    if name == "all identical":
        assert len(np.unique(once[0])) == 1


def test_a_query_that_is_a_phrase_is_never_better_than_it():
    it = CASES["a query is a phrase"]
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
        assert lexicon.understand(text).unknown == unknown
    for name, text in REFUSED.items():
        with pytest.raises(InputError) as error:
            lexicon.encode_text([text])
        assert len(str(error.value)) < 300, name
