"""Place codes so that what mixes at a border does not read as a third object.

Compositing at the border of objects a and b gives ``(1 - s) a + s b``. On its way from code a to
code b that value is nearest to a, then to b, if and only if no other code lies within the L1 ball
that has a and b on opposite sides: centre ``m = (a + b) / 2``, radius ``r = |a - b| / 2``. (At s
below one half it is s |a - b| from a. A code c with |m - c| >= r is at least r - (1/2 - s) |a - b|
= s |a - b| away. The other half is alike.) So objects that touch should have codes with room
between them, which often means close ones, and which object gets which code is searched for.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slgaussian.kernels.jit import kernel
from slgaussian.kernels.simd import LANES, vabs, vload, vsum, vwhere, vzero
from slgaussian.labels import LabelMaps
from slgaussian.language.nearest import nearest_code

GAPS = (1, 2, 4, 8, 16)
"""Objects that are so many pixels apart, along rows or columns, are neighbours; they count by one
over the square. What is not in touch in any given view may be in another: a step to the side moves
what is in front of what."""

MARGIN = 1.2
"""Codes are kept out of the ball between two neighbours' codes times this: other neighbours, not
given, and noise take their part too."""

MOVES_PER_OBJECT = 1000
MOST_COMPARISONS = 6e7
"""Moves tried, and the bound on moves times pairs of neighbours: half a second at most."""

HEAT = (1e-3, 1e-6)
"""Temperature at the start and the end of the search, as a share of the crowding at the start."""

ROUNDING = 1e-4
"""Relative error of sums of crowding, at most: they are float32."""

SHARES = 16
"""Mixtures of two neighbours that are looked at to say how many read as a third object."""


class Pairs(NamedTuple):
    """Objects that are near each other in some view.

    Attributes
    ----------
    rows : int64 [E, 2]
        Places in the ascending ids, the smaller first.
    weights : float64 [E]
        How much border they share; they sum to 1.
    """

    rows: np.ndarray
    weights: np.ndarray


def neighbours(label_maps: LabelMaps) -> Pairs:
    """Find the objects that come near each other, in any view; see :data:`GAPS`."""
    ids = label_maps.ids
    rows = np.searchsorted(ids, label_maps.labels)
    rows[label_maps.labels == 0] = -1
    keys, weights = [np.empty(0, np.int64)], [np.empty(0)]
    for gap in GAPS:
        for a, b in ((rows[..., gap:], rows[..., :-gap]), (rows[:, gap:], rows[:, :-gap])):
            meet = (a != b) & (a >= 0) & (b >= 0)
            a, b = a[meet], b[meet]
            pair_keys, counts = np.unique(
                np.minimum(a, b) * len(ids) + np.maximum(a, b), return_counts=True
            )
            keys.append(pair_keys)
            weights.append(counts / gap**2)
    pair_keys, place_of = np.unique(np.concatenate(keys), return_inverse=True)
    total = np.bincount(place_of, np.concatenate(weights), len(pair_keys))
    pairs = np.stack([pair_keys // max(len(ids), 1), pair_keys % max(len(ids), 1)], 1)
    return Pairs(pairs, total / max(total.sum(), 1e-300))


def place(n: int, pairs: Pairs, dimension: int, rng: np.random.Generator) -> np.ndarray:
    """Codes float32 [n, dimension] for objects with these neighbours, distinct points in [0, 1]."""
    points = _points(n, dimension)
    assignment = rng.permutation(len(points))[:n]
    weight = pairs.weights
    moves = int(min(MOVES_PER_OBJECT * n, MOST_COMPARISONS / max(len(weight), 1)))
    if n > 2 and len(weight):
        first = np.argsort(pairs.rows.ravel(), kind="stable")
        starts = np.searchsorted(pairs.rows.ravel()[first], np.arange(n + 1))
        padded = np.zeros((len(points), 3), np.float32)
        padded[:, :dimension] = points
        _anneal(
            padded, assignment, pairs.rows, *_layout(padded, assignment, weight), starts,
            first // 2, rng.integers(n, size=moves), rng.integers(len(points), size=moves),
            rng.random(moves), HEAT[0], HEAT[1],
        )  # fmt: skip
    return points[assignment].astype(np.float32)


def misread(codes: np.ndarray, pairs: Pairs) -> float:
    """Share of all mixtures of two neighbours whose nearest code is a third object's.

    Each pair counts by its weight, and each share of the one in the other alike.
    """
    a, b = pairs.rows.T
    shares = ((np.arange(SHARES) + 0.5) / SHARES)[:, None, None]
    nearest = nearest_code((1 - shares) * codes[a] + shares * codes[b], codes)
    return float((((nearest != a) & (nearest != b)) * pairs.weights).sum() / SHARES)


def _points(n: int, dimension: int) -> np.ndarray:
    """At least ``n`` points of [0, 1]^dimension, float64, of the coarsest grid that has them."""
    side = 1
    while True:
        side += 1
        grid = np.stack([*np.indices((side,) * dimension)], -1).reshape(-1, dimension)
        # Between no two corners of the cube is there a third, so few objects get corners.
        if dimension > 1 and side > 2:
            grid = grid[grid.sum(1) % 2 == 0]
        if len(grid) >= n:
            return grid / (side - 1)


def _layout(
    points: np.ndarray, assignment: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The object at each point, or -1; codes [3, ...], and balls [5, ...] without centres.

    Coordinates one after the other, filled up to whole vectors with codes far from all balls and
    balls that weigh nothing. A ball is its centre, 1 / (radius times MARGIN), and its weight.
    """
    owners = np.full(len(points), -1)
    owners[assignment] = np.arange(len(assignment))
    codes = np.full((3, -(-len(assignment) // LANES) * LANES), 1e6, np.float32)
    codes[:, : len(assignment)] = points[assignment].T
    balls = np.zeros((5, -(-len(weights) // LANES) * LANES), np.float32)
    balls[4, : len(weights)] = weights
    return owners, codes, balls


@kernel
def _anneal(
    points,
    assignment,
    pairs,
    owners,
    codes,
    balls,
    starts,
    touching,
    movers,
    targets,
    luck,
    hot,
    cold,
):
    """Move objects to free points, or swap two, so that balls between neighbours get emptier.

    ``assignment`` [n], the point of each object, is changed in place. The pairs of object i are
    ``touching[starts[i] : starts[i + 1]]``.
    """
    n, count = len(assignment), len(pairs)
    for e in range(count):
        _blow(e, pairs, codes, balls)
    start = np.float32(0)
    for e in range(count):
        start += balls[4, e] * _crowd(e, codes, balls)
    depths = np.empty(n + count, np.float32)
    depths[:] = np.nan
    none = depths[:0]
    for step in range(len(movers)):
        i, target = movers[step], targets[step]
        j, source = owners[target], assignment[i]
        if j == i:
            continue
        heat = start * hot * (cold / hot) ** (step / len(movers))
        before = _part(i, j, pairs, starts, touching, codes, balls, depths, np.inf)
        # What is added is never below zero, but for rounding: beyond this no luck is enough.
        bound = before - heat * np.log(luck[step]) + ROUNDING * before
        _move(i, target, points, assignment, owners, pairs, starts, touching, codes, balls)
        if j >= 0:
            _move(j, source, points, assignment, owners, pairs, starts, touching, codes, balls)
        else:
            owners[source] = -1
        worse = _part(i, j, pairs, starts, touching, codes, balls, none, bound) - before
        if worse > 0 and luck[step] >= np.exp(-worse / heat):
            _move(i, source, points, assignment, owners, pairs, starts, touching, codes, balls)
            if j >= 0:
                _move(j, target, points, assignment, owners, pairs, starts, touching, codes, balls)
            else:
                owners[target] = -1
        else:
            depths[:] = np.nan


@kernel
def _move(i, target, points, assignment, owners, pairs, starts, touching, codes, balls):
    assignment[i], owners[target] = target, i
    for k in range(3):  # for a slice Numba would compile the words of an error
        codes[k, i] = points[target, k]
    for at in range(starts[i], starts[i + 1]):
        _blow(touching[at], pairs, codes, balls)


@kernel(inline="always")
def _blow(e, pairs, codes, balls):
    """Make the ball of pair ``e`` anew; half way through a swap it may be a point."""
    a, b = pairs[e]
    radius = np.float32(0)
    for k in range(3):
        balls[k, e] = np.float32(0.5) * (codes[k, a] + codes[k, b])
        radius += np.float32(0.5) * abs(codes[k, a] - codes[k, b])
    balls[3, e] = np.float32(1) / (radius * np.float32(MARGIN))


@kernel(inline="always")
def _crowd(e, codes, balls):
    """Sum how deep all codes are in the ball of pair ``e``: 1 in the middle, 0 from the edge on.

    Those of the pair itself count too, the same wherever they are.
    """
    x, y, z, inverse = balls[0, e], balls[1, e], balls[2, e], balls[3, e]
    flat, room, total = codes.ravel(), codes.shape[1], vzero()
    for c in range(0, room, LANES):
        far = vabs(vload(flat, c) - x) + vabs(vload(flat, room + c) - y)
        far = far + vabs(vload(flat, 2 * room + c) - z)
        deep = np.float32(1) - far * inverse
        total = total + vwhere(deep > np.float32(0), deep, np.float32(0))
    return vsum(total)


@kernel(inline="always")
def _deep(e, i, codes, balls):
    far = abs(codes[0, i] - balls[0, e]) + abs(codes[1, i] - balls[1, e])
    far += abs(codes[2, i] - balls[2, e])
    return max(np.float32(0), np.float32(1) - far * balls[3, e])


@kernel
def _part(i, j, pairs, starts, touching, codes, balls, depths, bound):
    """The part of the weighted crowding that depends on the codes of i and j; j may be -1.

    It stops where the sum is above ``bound``. Nearly all moves are taken back, so that what objects
    and pairs add is read from ``depths`` or stored there, unless it is empty; NaN is unknown.
    """
    keep = len(depths) > 0
    total = np.float32(0)
    for k in (i, j):
        if k >= 0:
            alone = depths[k] if keep else np.float32(np.nan)
            if np.isnan(alone):
                alone = _everywhere(k, codes, balls)
                if keep:
                    depths[k] = alone
            total += alone
    for which, k in enumerate((i, j)):
        if k < 0:
            continue
        for at in range(starts[k], starts[k + 1]):
            e = touching[at]
            if which == 1 and (pairs[e, 0] == i or pairs[e, 1] == i):
                continue
            place = len(starts) - 1 + e
            crowd = depths[place] if keep else np.float32(np.nan)
            if np.isnan(crowd):
                crowd = _crowd(e, codes, balls)
                if keep:
                    depths[place] = crowd
            # All codes in this ball, but those that were counted above.
            crowd -= _deep(e, i, codes, balls)
            if j >= 0:
                crowd -= _deep(e, j, codes, balls)
            total += balls[4, e] * crowd
            if total > bound:
                return total
    return total


@kernel(inline="always")
def _everywhere(i, codes, balls):
    """Sum how deep the code of i is in all balls, by their weights."""
    x, y, z = codes[0, i], codes[1, i], codes[2, i]
    flat, room, total = balls.ravel(), balls.shape[1], vzero()
    for e in range(0, room, LANES):
        far = vabs(vload(flat, e) - x) + vabs(vload(flat, room + e) - y)
        far = far + vabs(vload(flat, 2 * room + e) - z)
        deep = np.float32(1) - far * vload(flat, 3 * room + e)
        deep = vwhere(deep > np.float32(0), deep, np.float32(0))
        total = total + deep * vload(flat, 4 * room + e)
    return vsum(total)
