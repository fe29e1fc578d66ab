"""Vectors on which relevancy breaks, by name, and what comes of each.

Errors are absolute differences of relevancies from the printed formula in decimal arithmetic of 60
digits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from decimal import Context, Decimal, localcontext
from functools import cache
from pathlib import Path

import numpy as np

from slgaussian.language.relevancy import relevancy

TEMPERATURES = (1.0, 10.0, 100.0, 1000.0)
JUDGED = 12
"""Objects of a case, spread over all, that the slow reference is asked about."""

CLIP_TEXTS = Path("clip_text/lvis_names_clip_text.npz")
"""``names`` and unit CLIP text vectors ``features`` [Q, 512] of them, in a folder of real data."""

_MAKERS: dict[str, Callable[[], Case]] = {}


@dataclass(frozen=True)
class Case:
    """Arguments of :func:`slgaussian.language.relevancy.relevancy`, in float64."""

    features: np.ndarray
    present: np.ndarray
    queries: np.ndarray
    canonical: np.ndarray


def _case(make: Callable[[], Case]) -> Callable[[], Case]:
    _MAKERS[make.__name__] = make
    return make


def names() -> list[str]:
    return list(_MAKERS)


@cache
def case(name: str) -> Case:
    return _MAKERS[name]()


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _random(n: int, views: int = 2, width: int = 512, seed: int = 0) -> Case:
    rng = np.random.default_rng(seed)
    features = unit(rng.normal(size=(n, views, width)))
    queries, canonical = unit(rng.normal(size=(3, width))), unit(rng.normal(size=(4, width)))
    present = rng.random((n, views)) < 0.7
    present[~present.any(1), 0] = True
    return Case(features, present, queries, canonical)


def _turned(vector: np.ndarray, angles: np.ndarray, seed: int) -> np.ndarray:
    """Unit vectors at ``angles`` from a unit vector, each in another direction."""
    aside = np.random.default_rng(seed).normal(size=(len(angles), len(vector)))
    aside = unit(aside - (aside @ vector)[:, None] * vector)
    return np.cos(angles)[:, None] * vector + np.sin(angles)[:, None] * aside


@_case
def random_directions() -> Case:
    """60 objects in 2 views, 512 wide; all cosines near 0"""
    return _random(60)


@_case
def cosines_near_one() -> Case:
    """objects, query and phrases within 1e-7 to 0.01 of one direction"""
    base = _random(40)
    middle = base.queries[0]
    near = [_turned(middle, np.geomspace(1e-7, 1e-2, n), seed) for seed, n in enumerate((80, 3, 4))]
    return Case(near[0].reshape(40, 2, -1), base.present, near[1], near[2])


@_case
def cosines_near_minus_one() -> Case:
    """objects opposite to query and phrases, within 1e-7 to 0.01"""
    base = cosines_near_one()
    return Case(-base.features, base.present, base.queries, base.canonical)


@_case
def query_and_its_opposite() -> Case:
    """the query 1, every canonical phrase -1"""
    base = cosines_near_one()
    return Case(base.features, base.present, base.queries, -base.canonical)


@_case
def narrow_cone() -> Case:
    """60 objects, all cosines between 0.6 and 0.9, as CLIP has them"""
    base = _random(60)
    middle = unit(np.ones(512))

    def drawn(vectors: np.ndarray) -> np.ndarray:
        return unit(middle + 0.6 * vectors)

    queries, canonical = drawn(base.queries), drawn(base.canonical)
    return Case(drawn(base.features), base.present, queries, canonical)


@_case
def all_identical() -> Case:
    """100 objects with one vector: all must tie"""
    base = _random(100)
    features = np.broadcast_to(base.features[0, 0], base.features.shape)
    return Case(features.copy(), base.present, base.queries, base.canonical)


@_case
def query_is_a_phrase() -> Case:
    """a query among the canonical phrases: 0.5 at most, and often exactly"""
    base = _random(60)
    return Case(base.features, base.present, base.canonical[:3], base.canonical)


@_case
def one_object() -> Case:
    """one object, one view, one axis"""
    one = np.ones((1, 1))
    return Case(one[None], np.ones((1, 1), bool), one, -one)


@_case
def ten_thousand() -> Case:
    """10,000 objects in 2 views, 64 wide"""
    return _random(10_000, width=64)


def clip_case(data: Path) -> Case:
    """real CLIP text vectors: 60 objects between two names each, 3 queries, 4 phrases"""
    with np.load(data / CLIP_TEXTS) as file:
        texts = unit(file["features"].astype(np.float64))
    texts = texts[np.random.default_rng(0).permutation(len(texts))]
    # The file is in half precision; means of two are not.
    objects = unit(texts[:60] + texts[60:120])[:, None]
    return Case(objects, np.ones((60, 1), bool), texts[120:123], texts[123:127])


def judged(case: Case) -> Case:
    """The case with no more objects than the reference has time for."""
    kept = np.unique(np.linspace(0, len(case.features) - 1, JUDGED).astype(int))
    return Case(case.features[kept], case.present[kept], case.queries, case.canonical)


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


def error(case: Case, temperature: float, half: bool = False) -> float:
    """Greatest error of a relevancy; with ``half``, of features rounded to half precision first."""
    case = judged(case)
    features = case.features.astype(np.float16) if half else case.features
    got = relevancy(features, case.present, case.queries, case.canonical, temperature)
    return float(np.abs(got - reference(case, temperature)).max())
