"""How large a thing is: the upright box around most of its points, however they lie scattered.

Points that were matched wrongly lie in front of a thing or behind it, some far away. So those much
farther from the middle than most are left out, and the box goes from a low percentile to a high one
along each of its axes, not from the first point to the last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slgaussian.io import short_repr

LEFT_OUT = 3.0
"""Percent of the points that lie beyond each end of an axis of the box."""

FAR = 3.0
"""Points are left out beyond so many times their median distance from the middle: twice is where a
straight thing ends."""

TURNS = 90
"""Directions that are tried for the sides of the box, a quarter turn in all."""

MOST = 2000
"""Points that are looked at, evenly of all."""


@dataclass(frozen=True, eq=False)
class Box:
    """A box in the world.

    Attributes
    ----------
    centre : float64 [3]
        Scene units.
    axes : float64 [3, 3]
        Unit vectors in rows, right-handed: along the longer side, along the shorter one, up.
    half_sizes : float64 [3]
        From the centre to the faces along the axes, scene units.
    """

    centre: np.ndarray
    axes: np.ndarray
    half_sizes: np.ndarray

    __repr__ = short_repr


def upright_box(points: np.ndarray, up: np.ndarray) -> Box:
    """The upright box of points float [N, 3], N at least 1, with ``up`` a unit vector [3].

    Of all turns about ``up``, that of the smallest ground: the sides of most things are walls of a
    right-angled box. All but :data:`LEFT_OUT` percent lie inside, at each end of each axis.
    """
    points = np.asarray(points, np.float64)[:: -(-len(points) // MOST)]
    away = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    points = points[away <= FAR * np.median(away)]
    side = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    side /= np.linalg.norm(side)
    other = np.cross(up, side)
    ground = points @ np.stack([side, other]).T
    angles = np.arange(TURNS) * (np.pi / 2 / TURNS)
    turned = np.stack([np.cos(angles), np.sin(angles)], 1)
    along, across = ground @ turned.T, ground @ np.stack([-turned[:, 1], turned[:, 0]])
    ends = [LEFT_OUT, 100 - LEFT_OUT]
    area = np.prod([np.ptp(np.percentile(one, ends, axis=0), axis=0) for one in (along, across)], 0)
    best = turned[area.argmin()]
    first = best[0] * side + best[1] * other
    axes = np.stack([first, np.cross(up, first), up])
    low, high = np.percentile(points @ axes.T, ends, axis=0)
    if (high - low)[1] > (high - low)[0]:
        axes = np.stack([axes[1], -axes[0], up])
        low, high = np.percentile(points @ axes.T, ends, axis=0)
    return Box((low + high) / 2 @ axes, axes, (high - low) / 2)
