"""Which inverse depths to try: range from sparse matches, number from the motion in pixels."""

from __future__ import annotations

import numpy as np

from slgaussian.cameras.relative import Relative

MIN_MATCHES = 12
"""Fewest triangulated matches that a depth range is estimated from."""

MIN_CANDIDATES = 32
"""Fewest that a sub-pixel fit is asked to interpolate."""

MAX_DEPTH = 1e4
"""Farthest estimated depth in baselines, where even a long lens sees no parallax."""

AGREEING = 3
SPREAD = 0.9
"""So many matches whose inverse depths are within this factor show a surface; fewer may be false
matches."""


def inverse_depth_range(inverse_depths: np.ndarray, baseline: float) -> tuple[float, float]:
    """Least and greatest inverse depth to try, from those of sparse matches.

    Matches sit on texture, not on the nearest or farthest surface, so the range is wider than they
    are: half of the 2nd and 1.25 times the 98th percentile, or 1.25 times the nearest depth that
    :data:`AGREEING` matches share, if that is more: what is near is often small.

    Parameters
    ----------
    inverse_depths : float64 [M]
        One per match, 1 / scene units; M > 0.
    baseline : float
        Distance between the cameras, scene units.
    """
    low, high = np.percentile(inverse_depths, (2, 98))
    low = max(0.5 * low, 1 / (MAX_DEPTH * baseline))
    falling = np.sort(inverse_depths)[::-1]
    first, last = falling[: 1 - AGREEING], falling[AGREEING - 1 :]
    nearest = first[last >= SPREAD * first][:1].max(initial=high)
    return float(low), float(max(1.25 * nearest, 2 * low))


def candidates(
    relative: Relative,
    size: tuple[int, int],
    low: float,
    high: float,
    most: int,
) -> np.ndarray:
    """Inverse depths float64 [D], ascending and evenly spaced from ``low`` to ``high``.

    The 90th percentile of the motion over the image between two neighbours is one pixel, as far
    as :data:`MIN_CANDIDATES` and ``most``, the stronger of the two, allow. ``size`` is (height,
    width).
    """
    grid = pixel_grid(size, 16)
    count = 512
    path = np.linspace(low, high, count)
    tracks, ratio = relative.project(grid[:, None], path)
    inside = (ratio > 0) & (tracks >= 0).all(-1) & (tracks <= size[::-1]).all(-1)
    steps = np.linalg.norm(np.diff(tracks, axis=1), axis=-1)
    seen = inside[:, 1:] & inside[:, :-1]
    longest = np.percentile(steps[seen], 90) * (count - 1) if seen.any() else 0
    number = int(np.clip(np.ceil(longest) + 1, min(MIN_CANDIDATES, most), most))
    return np.linspace(low, high, number)


def visible_share(relative: Relative, size: tuple[int, int], inverse_depths: np.ndarray) -> float:
    """Share of a coarse grid of pixels that some candidate sees in the source view, 0 to 1."""
    tracks, ratio = relative.project(pixel_grid(size, 16)[:, None], inverse_depths)
    inside = (ratio > 0) & (tracks >= 0).all(-1) & (tracks <= size[::-1]).all(-1)
    return float(inside.any(1).mean())


def pixel_grid(size: tuple[int, int], cells: int) -> np.ndarray:
    """Pixels [cells * cells, 2] evenly spread over an image of ``size`` (height, width)."""
    height, width = size
    fractions = (np.arange(cells) + 0.5) / cells
    u, v = np.meshgrid(fractions * width, fractions * height)
    return np.stack([u.ravel(), v.ravel()], 1)
