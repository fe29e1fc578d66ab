"""Assignment of codes such that mixtures at borders do not decode to a third object.

Compositing at the border of objects a and b gives ``(1 - s) a + s b``. This value is nearest to a,
then to b, if and only if no other code lies within the L1 ball with a and b on opposite sides:
centre ``m = (a + b) / 2``, radius ``r = |a - b| / 2``. (For s < 1/2 its distance from a is
s |a - b|, and a code c with |m - c| >= r is at least r - (1/2 - s) |a - b| = s |a - b| away; the
other half is symmetric.) Simulated annealing searches for an assignment in which few codes lie in
the balls of neighbouring objects. Codes of neighbours are then often close to each other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slgaussian.kernels.jit import kernel
from slgaussian.kernels.simd import LANES, vabs, vload, vsum, vwhere, vzero
from slgaussian.labels import LabelMaps
from slgaussian.language.nearest import nearest_code

GAPS = (1, 2, 4, 8, 16)
"""Distances in pixels, along rows or columns, at which objects count as neighbours, with weight
1 / distance^2. Objects that are close but do not touch may touch in another view."""

MARGIN = 1.2
"""Factor of the balls' radii: leaves room for noise and for neighbours that are not known."""

MOVES_PER_OBJECT = 1000
MOST_COMPARISONS = 6e7
"""Number of moves, and limit of moves times pairs of neighbours: half a second at most."""

HEAT = (1e-3, 1e-6)
"""Temperature at the start and the end of the annealing, relative to the initial energy."""

ROUNDING = 1e-4
"""Largest relative error of energies, which are float32."""

SHARES = 16
"""Number of mixtures per pair of neighbours in :func:`misread`."""


class Pairs(NamedTuple):
    """Pairs of objects that are near each other in some view.

    Attributes:
        rows: int64 [E, 2]. Indices into the ascending ids, the smaller first.
        weights: float64 [E]. Length of the common border, normalised to sum 1.
    """

    rows: np.ndarray
    weights: np.ndarray


def neighbours(label_maps: LabelMaps) -> Pairs:
    """Find the pairs of objects that are near each other in any view; see :data:`GAPS`."""
    ids = label_maps.ids
    rows = np.searchsorted(ids, label_maps.labels)
    rows[label_maps.labels == 0] = -1
    keys, weights = [np.empty(0, np.int64)], [np.empty(0)]
    for gap in GAPS:
        for a, b in ((rows[..., gap:], rows[..., :-gap]), (rows[:, gap:], rows[:, :-gap])):
            border = (a != b) & (a >= 0) & (b >= 0)
            a, b = a[border], b[border]
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
    """Choose distinct codes in [0, 1], float32 [n, dimension], for objects with these pairs."""
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
    """Compute the fraction of mixtures of two neighbours that decode to a third object.

    Pairs are weighted by ``weights``; all mixing ratios count equally.
    """
    a, b = pairs.rows.T
    shares = ((np.arange(SHARES) + 0.5) / SHARES)[:, None, None]
    nearest = nearest_code((1 - shares) * codes[a] + shares * codes[b], codes)
    return float((((nearest != a) & (nearest != b)) * pairs.weights).sum() / SHARES)


def _points(n: int, dimension: int) -> np.ndarray:
    """Return at least ``n`` points of [0, 1]^dimension, float64, of the coarsest such grid."""
    side = 1
    while True:
        side += 1
        grid = np.stack([*np.indices((side,) * dimension)], -1).reshape(-1, dimension)
        # No corner of the cube lies between two others, so all corners are used.
        if dimension > 1 and side > 2:
            grid = grid[grid.sum(1) % 2 == 0]
        if len(grid) >= n:
            return grid / (side - 1)


def _layout(
    points: np.ndarray, assignment: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lay out data for SIMD: the object at each point or -1, codes [3, ...] and balls [5, ...].

    Stored as one array per coordinate, padded to whole vectors with codes far from all balls and
    balls of weight 0. A ball is its centre (not yet set), 1 / (radius * MARGIN) and its weight.
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
    randoms,
    hot,
    cold,
):
    """Reduce the energy, the weighted depth of codes in balls, by simulated annealing.

    A move puts an object on a free point or swaps two objects. ``assignment`` [n], the point of
    each object, is changed in place. The pairs of object i are
    ``touching[starts[i] : starts[i + 1]]``; ``randoms`` are uniform in [0, 1).
    """
    n, count = len(assignment), len(pairs)
    for e in range(count):
        _update_ball(e, pairs, codes, balls)
    start = np.float32(0)
    for e in range(count):
        start += balls[4, e] * _ball_energy(e, codes, balls)
    depths = np.empty(n + count, np.float32)
    depths[:] = np.nan
    none = depths[:0]
    for step in range(len(movers)):
        i, target = movers[step], targets[step]
        j, source = owners[target], assignment[i]
        if j == i:
            continue
        heat = start * hot * (cold / hot) ** (step / len(movers))
        before = _energy_of(i, j, pairs, starts, touching, codes, balls, depths, np.inf)
        # Terms are non-negative up to rounding: once the sum exceeds this bound, the move is
        # rejected.
        bound = before - heat * np.log(randoms[step]) + ROUNDING * before
        _move(i, target, points, assignment, owners, pairs, starts, touching, codes, balls)
        if j >= 0:
            _move(j, source, points, assignment, owners, pairs, starts, touching, codes, balls)
        else:
            owners[source] = -1
        increase = _energy_of(i, j, pairs, starts, touching, codes, balls, none, bound) - before
        if increase > 0 and randoms[step] >= np.exp(-increase / heat):
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
    for k in range(3):  # not a slice, for which Numba compiles error messages
        codes[k, i] = points[target, k]
    for at in range(starts[i], starts[i + 1]):
        _update_ball(touching[at], pairs, codes, balls)


@kernel(inline="always")
def _update_ball(e, pairs, codes, balls):
    """Update the ball of pair ``e`` from its codes; during a swap its radius may be 0."""
    a, b = pairs[e]
    radius = np.float32(0)
    for k in range(3):
        balls[k, e] = np.float32(0.5) * (codes[k, a] + codes[k, b])
        radius += np.float32(0.5) * abs(codes[k, a] - codes[k, b])
    balls[3, e] = np.float32(1) / (radius * np.float32(MARGIN))


@kernel(inline="always")
def _ball_energy(e, codes, balls):
    """Sum the depth of all codes in the ball of pair ``e``: 1 at its centre, 0 from its edge on.

    The codes of the pair itself contribute a constant.
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
def _depth(e, i, codes, balls):
    far = abs(codes[0, i] - balls[0, e]) + abs(codes[1, i] - balls[1, e])
    far += abs(codes[2, i] - balls[2, e])
    return max(np.float32(0), np.float32(1) - far * balls[3, e])


@kernel
def _energy_of(i, j, pairs, starts, touching, codes, balls, depths, bound):
    """Compute the part of the energy that depends on the codes of i and j; j may be -1.

    Stops once the sum exceeds ``bound``. Most moves are rejected, so the contribution of each
    object and pair is cached in ``depths`` (NaN: not cached), unless it is empty.
    """
    keep = len(depths) > 0
    total = np.float32(0)
    for k in (i, j):
        if k >= 0:
            energy = depths[k] if keep else np.float32(np.nan)
            if np.isnan(energy):
                energy = _code_energy(k, codes, balls)
                if keep:
                    depths[k] = energy
            total += energy
    for which, k in enumerate((i, j)):
        if k < 0:
            continue
        for at in range(starts[k], starts[k + 1]):
            e = touching[at]
            if which == 1 and (pairs[e, 0] == i or pairs[e, 1] == i):
                continue
            place = len(starts) - 1 + e
            energy = depths[place] if keep else np.float32(np.nan)
            if np.isnan(energy):
                energy = _ball_energy(e, codes, balls)
                if keep:
                    depths[place] = energy
            # Without the codes of i and j, which were counted above.
            energy -= _depth(e, i, codes, balls)
            if j >= 0:
                energy -= _depth(e, j, codes, balls)
            total += balls[4, e] * energy
            if total > bound:
                return total
    return total


@kernel(inline="always")
def _code_energy(i, codes, balls):
    """Sum the weighted depth of the code of i in all balls."""
    x, y, z = codes[0, i], codes[1, i], codes[2, i]
    flat, room, total = balls.ravel(), balls.shape[1], vzero()
    for e in range(0, room, LANES):
        far = vabs(vload(flat, e) - x) + vabs(vload(flat, room + e) - y)
        far = far + vabs(vload(flat, 2 * room + e) - z)
        deep = np.float32(1) - far * vload(flat, 3 * room + e)
        deep = vwhere(deep > np.float32(0), deep, np.float32(0))
        total = total + deep * vload(flat, 4 * room + e)
    return vsum(total)
