"""Objects of an answer: one, a whole of several, or all that fit about as well."""

from dataclasses import replace

import numpy as np
import pytest

from slgaussian.language.lexicon import Lexicon
from slgaussian.language.wholes import (
    EVIDENCE_BOUNDS,
    MIN_BEST_GAP,
    MIN_PIXELS,
    MIN_SHARE,
    UNSEEN_GAP,
    Ranking,
    Wholes,
    near_best,
)

RANKING = Lexicon.ranking
AREAS = np.full(4, 1000)


@pytest.fixture
def mug():
    """A wall (0), a mug (1) and its handle (2), which make a whole, and another mug (3)."""
    borders = {(0, 1): (300, 240), (0, 2): (60, 50), (1, 2): (20, 2), (0, 3): (300, 240)}
    return Wholes(
        np.array([[False, True, True, False], [True] * 4]),
        np.array([0.3, 0.1, 0.1, 0.4, 0.9, 0.0], np.float32),
        np.array([[0.8, 0.8], [0.08, 0.08], [0.02, 0.02], [0.1, 0.1]], np.float32),
        np.array([900, 0, 0, 0], np.float32),
        np.array(list(borders), np.int32),
        np.array(list(borders.values()), np.float32),
    )


def best_members(wholes, gaps, evidence=None, areas=AREAS, ranking=RANKING):
    evidence = np.zeros(len(gaps)) if evidence is None else evidence
    of_views = np.stack([evidence, evidence], 1)
    chosen = wholes.candidates(np.array([gaps], float), of_views[None], np.asarray(areas)).best(
        ranking
    )
    return np.flatnonzero(chosen[0]).tolist()


def test_best_candidate_is_a_whole_with_a_part_that_fits_badly(mug):
    gaps = [-0.1, 0.2, 0.1, -0.05]
    assert near_best(np.array(gaps), 0.2).tolist() == [False, True, False, False]
    assert best_members(mug, gaps) == [1, 2]
    alone = replace(mug, members=mug.members[1:], standing=np.delete(mug.standing, 4))
    assert best_members(alone, gaps) == [1]


def test_best_candidate_is_the_near_best_set(mug):
    assert best_members(mug, [-0.1, 0.2, -0.1, 0.2]) == [1, 3]


def test_class_evidence_decides_between_equal_gaps(mug):
    gaps = [-0.1, 0.1, 0.1, 0.1]
    assert best_members(mug, gaps, np.array([-3, 4, 4, -3.0])) == [1, 2]
    assert best_members(mug, gaps, np.array([-3, -3, -3, 4.0])) == [3]
    assert best_members(mug, gaps, np.array([-3, -9, -9, 99.0])) == [3], "evidence is bounded"


def test_best_candidate_excludes_invisible_objects(mug):
    gaps = [-0.1, 0.2, 0.1, 0.01]
    assert best_members(mug, gaps, areas=[1000, 0, 0, 1000]) == [3]
    assert best_members(mug, gaps, areas=np.zeros(4, int)) == []
    assert best_members(mug, [-np.inf] * 4) == []
    assert 2 not in best_members(mug, [-0.1, 0.2, -np.inf, 0.2])
    assert best_members(mug, [-0.1, -0.2, -0.2, -0.2]) != [], "a best guess, however badly it fits"


@pytest.mark.parametrize("seed", range(6))
def test_best_candidate_equals_the_loop_reference(seed):
    rng = np.random.default_rng(seed)
    n, w = int(rng.integers(2, 9)), int(rng.integers(0, 6))
    members = rng.random((w, n)) < 0.5
    pairs = np.array([(a, b) for a in range(n) for b in range(a + 1, n)], np.int32)
    pairs = pairs[rng.random(len(pairs)) < 0.6]
    wholes = Wholes(
        members,
        rng.random(n + w).astype(np.float32),
        (rng.random((n, 2)) * (rng.random((n, 2)) < 0.8) / n).astype(np.float32),
        rng.integers(0, 50, n).astype(np.float32),
        pairs,
        rng.uniform(1, 90, (len(pairs), 2)).astype(np.float32),
    )
    gaps = np.where(rng.random((5, n)) < 0.15, -np.inf, rng.normal(0, 0.1, (5, n)))
    areas, evidence = rng.integers(0, 300, n), rng.normal(0, 4, (5, n, 2))
    evidence[rng.random((5, n, 2)) < 0.2] = np.nan
    evidence[0] = 0
    ranking = Ranking(*rng.normal(0, 1, len(Ranking._fields)))
    chosen = wholes.candidates(gaps, evidence, areas).best(ranking)
    for text in zip(chosen, gaps, evidence, strict=True):
        assert np.array_equal(text[0], choose_plainly(wholes, *text[1:], areas, ranking))


def choose_plainly(wholes, gaps, evidence, areas, ranking):
    """The choice in loops over sets of places."""
    n = len(gaps)
    share = wholes.shares.astype(float)
    size = share.mean(1)
    visible = {i for i in range(n) if areas[i] > 0 and gaps[i] > -np.inf}
    top = max([gaps[i] for i in visible] + [MIN_BEST_GAP])
    similar = {i for i in range(n) if gaps[i] > 0 and gaps[i] >= 0.6 * top}
    gap = [g if g > -np.inf else UNSEEN_GAP for g in gaps]
    nodes = [{i} for i in range(n)] + [set(np.flatnonzero(row)) for row in wholes.members]
    candidates = [
        (node, float(stands))
        for node, stands in zip(nodes, wholes.standing, strict=True)
        if sum(size[i] for i in node) >= MIN_SHARE
        and sum(areas[i] for i in node & visible) >= MIN_PIXELS
    ]
    if similar & visible:
        candidates.append((similar, 0.0))
    sums = dict(zip(map(tuple, wholes.borders.tolist()), wholes.border_sums.tolist(), strict=True))
    best_place = max(visible, key=lambda i: (gaps[i], -i), default=None)
    evidence = np.where(np.isnan(evidence), 0, evidence) * share
    ev = np.clip(evidence.sum(1) / np.maximum(share.sum(1), 1e-12), *EVIDENCE_BOUNDS)
    best, best_score = set(), -np.inf
    for node, stands in candidates:
        area = sum(size[i] for i in node)
        mean = sum(size[i] * gap[i] for i in node) / area
        ring = {}
        length = strength = 0.0
        for (a, b), (long, strong) in sums.items():
            if (a in node) != (b in node):
                outside = b if a in node else a
                ring[outside] = ring.get(outside, 0) + long
                length, strength = length + long, strength + strong
        around = sum(v * gap[i] for i, v in ring.items()) / max(sum(ring.values()), 1e-9)
        edge = sum(float(wholes.at_edge[i]) for i in node)
        views = [sum(share[i, v] for i in node) for v in range(share.shape[1])]

        def recall(values, node=node):
            every = sum(size[i] * max(values[i], 0) for i in visible)
            return sum(size[i] * max(values[i], 0) for i in visible & node) / max(every, 1e-12)

        numbers = Ranking(
            max(mean / top, -2),
            max(around / top, -2),
            mean,
            recall(gap),
            best_place in node,
            node & visible == similar & visible,
            sum(size[i] * ev[i] for i in node) / area,
            recall(ev),
            np.log(area),
            strength / max(length, 1),
            edge / max(length + edge, 1),
            stands,
            min(views) / max(views),
        )
        score = float(np.dot(numbers, ranking))
        if score > best_score:
            best, best_score = node, score
    return np.array([i in best and gaps[i] > -np.inf for i in range(n)])
