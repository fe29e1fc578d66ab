"""Where things lie to one another as a camera sees them, and which of several is the largest.

Left, right, near and behind are the camera's: columns of its picture and depths along its axis.
Above, below and on are the room's: heights along its up. A thing is known by points on its surface,
most of them where photographs saw it, so each of its ends is that of most points and not of all.

Relations are strict: of two things that lie half behind each other neither is left of the other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slgaussian.formats.brief import brief
from slgaussian.geometry.boxes import FAR, upright_box
from slgaussian.scene import Camera

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

MOST = 1200
"""Points of an object that are looked at, evenly of all."""

ENDS = (10.0, 50.0, 90.0)
"""Percentiles of the points that are the low end, the middle and the high end of a thing."""

OVERLAP = 0.5
"""Two things come one after the other if they share no more of the shorter one than this."""

SPACINGS = 2.0
"""Things touch where their points come as near as so many times the spacing of their points."""

NEIGHBOURS = 6
"""The spacing is the distance to the neighbour of this rank: the first may be the same spot, as
another photograph shows it."""

CLOSE = 0.05
"""They also touch within so much of the size of the smaller one: something may hide the seam."""

SEAM = 0.01
"""As many points of both must be that near as this share of the smaller one's: stray ones are no
seam."""

AROUND = 0.25
"""A seam is looked for within so much of the size of the smaller thing around it."""

BESIDE = 0.75
"""A thing is next to another within so many times the geometric mean of their sizes."""

FOOT = 1 / 3
"""A thing stands on what it touches with no more than so much of its height, from below."""

THIN = 0.25
"""A thing stands upright, like a wall or a door, if it is so much thinner than it is high."""

CUT = 0.02
"""A thing is cut by the edge of a picture if so much of its points lie outside, or at the edge."""

EDGE = 0.01
"""What counts as the edge, a share of the picture's sides."""


@dataclass(frozen=True, eq=False)
class Extent:
    """Where a thing is, as a camera sees it.

    Attributes
    ----------
    points : float64 [P, 3]
        On its surface, world coordinates.
    columns, depths, heights : float64 [3]
        Low end, middle and high end: of x / z in the camera, of z, and along the room's up.
    size : float
        Diagonal of its upright box. Depths, heights and size are in scene units.
    thickness : float
        Its shortest level side.
    cut : bool
        Whether it reaches over the edge of the camera's picture.
    """

    points: np.ndarray
    columns: np.ndarray
    depths: np.ndarray
    heights: np.ndarray
    size: float
    thickness: float
    cut: bool

    __repr__ = brief


def extent(points: np.ndarray, camera: Camera, up: np.ndarray) -> Extent:
    """The extent of a thing of points float [P, 3], P at least 1; ``up`` is a unit vector."""
    points = _together(points)
    some = _evenly(points)
    pixels, depths = camera.project(some)
    ahead = depths > 0
    if not ahead.any():
        ahead = np.ones(len(some), bool)
    bearing = (pixels[ahead, 0] - camera.K[0, 2]) / camera.K[0, 0]
    box = upright_box(some, up)
    sides = np.array([camera.width, camera.height])
    inside = (depths > 0) & ((pixels > EDGE * sides) & (pixels < (1 - EDGE) * sides)).all(1)
    return Extent(
        points,
        np.percentile(bearing, ENDS),
        np.percentile(depths[ahead], ENDS),
        np.percentile(some @ up, ENDS),
        float(2 * np.linalg.norm(box.half_sizes)),
        float(2 * box.half_sizes[1]),
        bool(1 - inside.mean() > CUT),
    )


def holds(relation: str, a: Extent, b: Extent, up: np.ndarray) -> bool:
    """Whether ``a`` lies so to ``b``; relations as in :mod:`slgaussian.language.sentences`.

    ``left of`` and ``right of`` compare columns, ``behind`` and ``in front of`` depths of things
    whose columns meet, ``above`` and ``below`` heights of such. ``on``: it touches from above, or
    is upon what stands upright as a wall does. ``next to``: no farther than the two are large.
    ``part of``: it touches, and is smaller.
    """
    match relation:
        case "left of":
            return _before(a.columns, b.columns)
        case "right of":
            return _before(b.columns, a.columns)
        case "behind":
            return _before(b.depths, a.depths) and _meet(a.columns, b.columns)
        case "in front of":
            return _before(a.depths, b.depths) and _meet(a.columns, b.columns)
        case "above":
            return _before(b.heights, a.heights) and _meet(a.columns, b.columns)
        case "below":
            return _before(a.heights, b.heights) and _meet(a.columns, b.columns)
        case "on":
            return _on(a, b, up)
        case "next to":
            return distance(a.points, b.points) <= BESIDE * math.sqrt(a.size * b.size)
        case "part of":
            return a.size < b.size and touching(a.points, b.points)
    raise ValueError(f"relation {relation!r}")


def order(superlative: str, things: Sequence[Extent], anchor: Extent | None = None) -> np.ndarray:
    """Indices of things, that which is most so first; of equal ones the first given.

    With an ``anchor``, nearest and farthest are meant from there, else from the camera.
    """
    match superlative:
        case "largest" | "smallest":
            values = [one.size for one in things]
        case "nearest" | "farthest" if anchor is not None:
            values = [distance(one.points, anchor.points) for one in things]
        case "nearest" | "farthest":
            values = [one.depths[1] for one in things]
        case "highest" | "lowest":
            values = [one.heights[1] for one in things]
        case "tallest":
            values = [one.heights[2] - one.heights[0] for one in things]
        case "leftmost" | "rightmost":
            values = [one.columns[1] for one in things]
        case _:
            raise ValueError(f"superlative {superlative!r}")
    least = superlative in ("smallest", "nearest", "lowest", "leftmost")
    return np.argsort(np.array(values) if least else -np.array(values), kind="stable")


def joined(things: Sequence[np.ndarray]) -> np.ndarray:
    """Which things hang together, through others too: a number from 0 for each, int [M].

    ``things`` are points float [P, 3] each, P at least 1.
    """
    if not things:
        return np.zeros(0, np.int64)
    points = [_together(one) for one in things]
    touch = np.zeros((len(points), len(points)), bool)
    for i, one in enumerate(points):
        for j in range(i):
            touch[i, j] = touching(one, points[j])
    from scipy.sparse.csgraph import connected_components

    _, number = connected_components(touch, directed=False)
    return number.astype(np.int64)


def touching(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two things of points float [P, 3] and [Q, 3] touch."""
    return bool(len(_seam(a, b)))


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Between the nearest points of two things, but for the nearest hundredth of the smaller."""
    small, large = (a, b) if _length(a) <= _length(b) else (b, a)
    return float(np.percentile(_tree(large).query(_evenly(small))[0], 100 * SEAM))


def _seam(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Where two things touch: points [S, 3] of the smaller one; none if they do not touch."""
    small, large = (a, b) if _length(a) <= _length(b) else (b, a)
    size = _length(small)
    low, high = small.min(0) - AROUND * size, small.max(0) + AROUND * size
    large = large[((large >= low) & (large <= high)).all(1)]
    if not len(large):
        return large
    small, large = _evenly(small), _evenly(large)
    near = max(SPACINGS * _spacing(small), SPACINGS * _spacing(large), CLOSE * size)
    seam = small[_tree(large).query(small)[0] <= near]
    other = int(np.count_nonzero(_tree(small).query(large)[0] <= near))
    return seam if min(len(seam), other) >= max(1.0, SEAM * len(small)) else seam[:0]


def _length(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(points, 0)))


def _spacing(points: np.ndarray) -> float:
    """Median distance of a point to its neighbour of rank :data:`NEIGHBOURS`."""
    if len(points) <= NEIGHBOURS:
        return 0.0
    return float(np.median(_tree(points).query(points, k=[NEIGHBOURS + 1])[0]))


def _on(a: Extent, b: Extent, up: np.ndarray) -> bool:
    seam = _seam(a.points, b.points)
    if not len(seam):
        return False
    low, middle, high = a.heights
    at = float(np.median(seam @ up))
    if at <= low + FOOT * (high - low) and middle > at:
        return True
    upright = b.thickness < THIN * (b.heights[2] - b.heights[0])
    return bool(upright and b.heights[0] < middle < b.heights[2] and a.size < b.size)


def _before(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether interval ``a`` [3] comes before ``b`` [3]."""
    shared = min(a[2], b[2]) - max(a[0], b[0])
    return bool(a[1] < b[1] and shared <= OVERLAP * min(a[2] - a[0], b[2] - b[0]))


def _meet(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(a[0] <= b[2] and b[0] <= a[2])


def _together(points: np.ndarray) -> np.ndarray:
    """The points without those far from the others."""
    points = np.asarray(points, np.float64)
    away = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    return points[away <= FAR * np.median(away)]


def _tree(points: np.ndarray) -> cKDTree:
    from scipy.spatial import cKDTree  # which takes long to import, and few questions need it

    return cKDTree(points)


def _evenly(points: np.ndarray) -> np.ndarray:
    """At most :data:`MOST` of the points."""
    return points[:: -(-len(points) // MOST)]
