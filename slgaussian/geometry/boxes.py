"""Upright bounding boxes of objects, robust to wrongly matched points, some of them far away."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slgaussian.io import short_repr

TRIMMED_PERCENT = 3.0
"""Percentage of points beyond each end of an axis of the box."""

MAX_RELATIVE_DISTANCE = 3.0
"""Distance from the median point, in units of the median distance, beyond which points are dropped:
a straight object ends at twice that."""

TESTED_ORIENTATIONS = 90
"""Number of tested orientations over a quarter turn."""

MAX_POINTS = 2000
"""Largest number of points, taken evenly."""


@dataclass(frozen=True, eq=False)
class Box:
    """A box in the world.

    Attributes:
        centre: float64 [3]. Scene units.
        axes: float64 [3, 3]. Unit vectors in rows, right-handed: along the longer side, along the
            shorter one, up.
        half_sizes: float64 [3]. Distances from the centre to the faces along the axes, scene units.
    """

    centre: np.ndarray
    axes: np.ndarray
    half_sizes: np.ndarray

    __repr__ = short_repr


def upright_box(points: np.ndarray, up: np.ndarray) -> Box:
    """Fit an upright box to points float [N, 3], N at least 1, with ``up`` a unit vector [3].

    The orientation about ``up`` minimises the ground area. All but :data:`TRIMMED_PERCENT` percent
    of the points lie inside at each end of each axis.
    """
    points = np.asarray(points, np.float64)[:: -(-len(points) // MAX_POINTS)]
    distances = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    points = points[distances <= MAX_RELATIVE_DISTANCE * np.median(distances)]
    side = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    side /= np.linalg.norm(side)
    side_b = np.cross(up, side)
    ground = points @ np.stack([side, side_b]).T
    angles = np.arange(TESTED_ORIENTATIONS) * (np.pi / 2 / TESTED_ORIENTATIONS)
    directions = np.stack([np.cos(angles), np.sin(angles)], 1)
    along, across = ground @ directions.T, ground @ np.stack([-directions[:, 1], directions[:, 0]])
    ends = [TRIMMED_PERCENT, 100 - TRIMMED_PERCENT]
    extents = [np.ptp(np.percentile(axis, ends, axis=0), axis=0) for axis in (along, across)]
    area = np.prod(extents, 0)
    best = directions[area.argmin()]
    first = best[0] * side + best[1] * side_b
    axes = np.stack([first, np.cross(up, first), up])
    low, high = np.percentile(points @ axes.T, ends, axis=0)
    if (high - low)[1] > (high - low)[0]:
        axes = np.stack([axes[1], -axes[0], up])
        low, high = np.percentile(points @ axes.T, ends, axis=0)
    return Box((low + high) / 2 @ axes, axes, (high - low) / 2)
