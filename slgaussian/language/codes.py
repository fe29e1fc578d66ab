"""ID codes: three numbers in [0, 1] for every object (paper, section 3.2).

The paper chooses N points of a grid of ceil(cbrt N)^3 points at random; a rendered vector is
decoded to the object whose code is nearest in L1 (:mod:`slgaussian.language.nearest`).

:class:`Separated` assigns codes such that mixtures at borders do not decode to a third object.
Compositing at the border of objects a and b gives ``(1 - s) a + s b``. This value is nearest to a,
then to b, if and only if no other code lies within the L1 ball with a and b on opposite sides:
centre ``m = (a + b) / 2``, radius ``r = |a - b| / 2``. (For s < 1/2 its distance from a is
s |a - b|, and a code c with |m - c| >= r is at least r - (1/2 - s) |a - b| = s |a - b| away; the
other half is symmetric.) Simulated annealing searches for an assignment in which few codes lie in
the balls of neighbouring objects.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slgaussian.errors import InputError
from slgaussian.kernels.jit import kernel
from slgaussian.labels import LabelMaps
from slgaussian.language.configs import GridConfig

NEIGHBOUR_DISTANCES = (1, 2, 4, 8, 16)
"""Distances in pixels, along rows or columns, at which objects count as neighbours, with weight
1 / distance^2. Objects that are close but do not touch may touch in another view."""

RADIUS_MARGIN = 1.2
"""Factor of the balls' radii: leaves room for noise and for neighbours that are not known."""

MOVES_PER_OBJECT = 1000
MAX_COMPARISONS = 6e7
"""Number of moves, and limit of moves times pairs of neighbours: a second at most."""

TEMPERATURES = (1e-3, 1e-6)
"""Temperature at the start and the end of the annealing, relative to the initial energy."""


class Grid(GridConfig):
    """The paper's codes: random points of an even grid.

    With ``decode="settled"`` views are decoded by :class:`slgaussian.semantic.decode.Decoder`, with
    ``nearest`` by :class:`slgaussian.semantic.decode.NearestCode`, as the paper does.
    """

    def __call__(self, label_maps: LabelMaps, rng: np.random.Generator) -> np.ndarray:
        """See :class:`slgaussian.language.CodeStrategy`."""
        return grid_codes(count_objects(label_maps), rng)


@dataclass(frozen=True)
class Separated:
    """Points of a checkerboard grid, assigned to objects by simulated annealing; see the module.

    Every second point of a grid is used: such points are farther apart in L1 than equally many of a
    full grid. If the cube has enough corners for all objects, only corners are used.
    """

    def __call__(self, label_maps: LabelMaps, rng: np.random.Generator) -> np.ndarray:
        """See :class:`slgaussian.language.CodeStrategy`."""
        return place(count_objects(label_maps), neighbours(label_maps), rng)


def grid_codes(n: int, rng: np.random.Generator) -> np.ndarray:
    """Draw distinct codes of ``n`` > 0 objects from the paper's even grid, float32 [n, 3].

    The grid on [0, 1]^3, ends included, has k points per axis, k the smallest integer with
    k^3 >= n. A single object gets the centre.
    """
    k = math.ceil(round(math.cbrt(n), 9))  # rounded, as the root of a cube may be slightly larger
    levels = np.linspace(0, 1, k, dtype=np.float32) if k > 1 else np.array([0.5], np.float32)
    chosen = rng.choice(k**3, n, replace=False)
    return np.stack([levels[axis] for axis in np.unravel_index(chosen, (k, k, k))], 1)


def count_objects(label_maps: LabelMaps) -> int:
    """Count the objects; InputError if there is none."""
    n = len(label_maps.ids)
    if n == 0:
        raise InputError("ID codes: the label maps hold no object; nothing could be queried")
    return n


class Pairs(NamedTuple):
    """Pairs of objects that are near each other in some view.

    Attributes:
        rows: int64 [E, 2]. Indices into the ascending ids, the smaller first.
        weights: float64 [E]. Length of the common border, normalised to sum 1.
    """

    rows: np.ndarray
    weights: np.ndarray


def neighbours(label_maps: LabelMaps) -> Pairs:
    """Find the pairs of objects that are neighbours in any view (:data:`NEIGHBOUR_DISTANCES`)."""
    ids = label_maps.ids
    rows = np.searchsorted(ids, label_maps.labels)
    rows[label_maps.labels == 0] = -1
    base, keys, weights = max(len(ids), 1), [], []
    for gap in NEIGHBOUR_DISTANCES:
        for a, b in ((rows[..., gap:], rows[..., :-gap]), (rows[:, gap:], rows[:, :-gap])):
            border = (a != b) & (a >= 0) & (b >= 0)
            pair_keys, counts = np.unique(
                np.minimum(a, b)[border] * base + np.maximum(a, b)[border], return_counts=True
            )
            keys.append(pair_keys)
            weights.append(counts / gap**2)
    pair_keys, place_of = np.unique(np.concatenate(keys), return_inverse=True)
    total = np.bincount(place_of, np.concatenate(weights), len(pair_keys))
    return Pairs(np.stack(np.divmod(pair_keys, base), 1), total / max(total.sum(), 1e-300))


def place(n: int, pairs: Pairs, rng: np.random.Generator) -> np.ndarray:
    """Choose distinct codes in [0, 1], float32 [n, 3], for objects with these pairs."""
    points = checkerboard(n)
    assignment = rng.permutation(len(points))[:n]
    moves = int(min(MOVES_PER_OBJECT * n, MAX_COMPARISONS / max(len(pairs.weights), 1)))
    if n > 2 and len(pairs.weights):
        _anneal(
            points, assignment, pairs.rows, pairs.weights.astype(np.float32),
            rng.integers(n, size=moves), rng.integers(len(points), size=moves), rng.random(moves),
        )  # fmt: skip
    return points[assignment]


def checkerboard(n: int) -> np.ndarray:
    """Return at least ``n`` points of the cube, float32 [P, 3]: its corners, or every second
    point of the coarsest grid that has enough."""
    side = 2
    while (side**3 if side == 2 else (side**3 + 1) // 2) < n:
        side += 1
    grid = np.stack([*np.indices((side,) * 3)], -1).reshape(-1, 3)
    # No corner of the cube lies between two others, so all corners are used.
    used = grid if side == 2 else grid[grid.sum(1) % 2 == 0]
    return (used / (side - 1)).astype(np.float32)


@kernel
def _anneal(points, assignment, pairs, weights, movers, targets, randoms):
    """Reduce the energy, the weighted depth of codes in balls, by simulated annealing.

    A move puts an object on a free point or swaps two. ``assignment`` [n] is changed in place.
    """
    owners = np.full(len(points), -1)
    owners[assignment] = np.arange(len(assignment))
    codes = np.ascontiguousarray(points[assignment].T)
    balls = np.empty((5, len(pairs)), np.float32)  # centre, 1 / (radius * RADIUS_MARGIN), weight
    balls[4] = weights
    start = np.float32(0)
    for e in range(len(pairs)):
        _update_ball(e, pairs, codes, balls)
        start += _ball_energy(e, codes, balls)
    for step in range(len(movers)):
        i, target = movers[step], targets[step]
        j, source = owners[target], assignment[i]
        if j == i:
            continue
        heat = start * TEMPERATURES[0] * (TEMPERATURES[1] / TEMPERATURES[0]) ** (step / len(movers))
        limit = _measure_energy(i, j, pairs, codes, balls, np.inf) - heat * np.log(randoms[step])
        _move(i, points[target], pairs, codes, balls)
        if j >= 0:
            _move(j, points[source], pairs, codes, balls)
        if _measure_energy(i, j, pairs, codes, balls, limit) <= limit:
            assignment[i], owners[target], owners[source] = target, i, j
            if j >= 0:
                assignment[j] = source
        else:
            _move(i, points[source], pairs, codes, balls)
            if j >= 0:
                _move(j, points[target], pairs, codes, balls)


@kernel
def _move(i, point, pairs, codes, balls):
    """Give object ``i`` the code ``point`` [3]."""
    for k in range(3):  # not a slice, for which Numba compiles error messages
        codes[k, i] = point[k]
    for e in range(len(pairs)):
        if pairs[e, 0] == i or pairs[e, 1] == i:
            _update_ball(e, pairs, codes, balls)


@kernel(inline="always")
def _update_ball(e, pairs, codes, balls):
    """Update the ball of pair ``e`` from its codes; during a swap its radius may be 0."""
    a, b = pairs[e]
    radius = np.float32(0)
    for k in range(3):
        balls[k, e] = np.float32(0.5) * (codes[k, a] + codes[k, b])
        radius += np.float32(0.5) * abs(codes[k, a] - codes[k, b])
    balls[3, e] = np.float32(1) / (radius * np.float32(RADIUS_MARGIN))


@kernel(inline="always")
def _depth(c, e, codes, balls):
    """Compute the weighted depth of code ``c`` in the ball of pair ``e``: 0 outside."""
    far = abs(codes[0, c] - balls[0, e]) + abs(codes[1, c] - balls[1, e])
    far += abs(codes[2, c] - balls[2, e])
    return balls[4, e] * max(np.float32(0), np.float32(1) - far * balls[3, e])


@kernel(fastmath={"reassoc", "contract"})  # sums in any order, and so by SIMD
def _ball_energy(e, codes, balls):
    """Sum the depth of all codes in the ball of pair ``e``."""
    total = np.float32(0)
    for c in range(codes.shape[1]):
        total += _depth(c, e, codes, balls)
    return total


@kernel(fastmath={"reassoc", "contract"})
def _code_energy(c, codes, balls):
    """Sum the depth of code ``c`` in all balls."""
    total = np.float32(0)
    for e in range(balls.shape[1]):
        total += _depth(c, e, codes, balls)
    return total


@kernel
def _measure_energy(i, j, pairs, codes, balls, limit):
    """Compute the energy that depends on the codes of i and j (-1: none); stop above ``limit``."""
    total = _code_energy(i, codes, balls)
    if j >= 0:
        total += _code_energy(j, codes, balls)
    for e in range(len(pairs)):
        a, b = pairs[e]
        if total > limit:
            break
        if a in (i, j) or b in (i, j):
            # Without the codes of i and j, which were counted above.
            total += _ball_energy(e, codes, balls) - _depth(i, e, codes, balls)
            if j >= 0:
                total -= _depth(j, e, codes, balls)
    return total
