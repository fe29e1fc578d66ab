"""Depth hypotheses: their range from sparse matches, their number from the motion in pixels."""

from __future__ import annotations

import numpy as np

from slgaussian.cameras.relative import Relative

MIN_MATCHES = 12
"""Smallest number of triangulated matches from which a depth range is estimated."""

MIN_CANDIDATES = 32
"""Smallest number of candidates between which the sub-pixel fit interpolates."""

MAX_DEPTH = 1e4
"""Farthest estimated depth in baselines, where even a long lens shows no parallax."""

MIN_AGREEING = 3
AGREEMENT_FACTOR = 0.9
"""Number of matches with inverse depths within this factor that establish a surface; fewer may be
false matches."""


def inverse_depth_range(inverse_depths: np.ndarray, baseline: float) -> tuple[float, float]:
    """Estimate the smallest and greatest inverse depth of a scene from sparse matches.

    Matches lie on texture and not on the nearest or farthest surface, so the range is wider than
    theirs: from half of the 2nd percentile to 1.25 times the 98th, or to 1.25 times the nearest
    depth that :data:`MIN_AGREEING` matches share if that is greater, because near objects are often
    small.

    Args:
        inverse_depths: float64 [M]. One per match, 1 / scene units; M > 0.
        baseline: Distance between the cameras, scene units.
    """
    low, high = np.percentile(inverse_depths, (2, 98))
    low = max(0.5 * low, 1 / (MAX_DEPTH * baseline))
    falling = np.sort(inverse_depths)[::-1]
    first, last = falling[: 1 - MIN_AGREEING], falling[MIN_AGREEING - 1 :]
    nearest = first[last >= AGREEMENT_FACTOR * first][:1].max(initial=high)
    return float(low), float(max(1.25 * nearest, 2 * low))


def inverse_depth_candidates(
    relative: Relative, size: tuple[int, int], low: float, high: float, maximum: int
) -> np.ndarray:
    """Return ascending, evenly spaced inverse depths from ``low`` to ``high``, float64 [D].

    D is chosen so that the 90th percentile over the image of the motion between two neighbours is
    one pixel, with at least :data:`MIN_CANDIDATES` and at most ``maximum`` candidates; the latter
    takes precedence. ``size`` is (height, width).
    """
    count = 512
    tracks, inside = _tracks(relative, size, np.linspace(low, high, count))
    steps = np.linalg.norm(np.diff(tracks, axis=1), axis=-1)
    visible = inside[:, 1:] & inside[:, :-1]
    longest = np.percentile(steps[visible], 90) * (count - 1) if visible.any() else 0
    number = int(np.clip(np.ceil(longest) + 1, min(MIN_CANDIDATES, maximum), maximum))
    return np.linspace(low, high, number)


def visible_share(relative: Relative, size: tuple[int, int], inverse_depths: np.ndarray) -> float:
    """Return the share of pixels that lie inside the source view at some candidate, 0 to 1."""
    return float(_tracks(relative, size, inverse_depths)[1].any(1).mean())


def _tracks(
    relative: Relative, size: tuple[int, int], inverse_depths: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels in the source of a coarse grid at all candidates, and which are inside it."""
    tracks, ratio = relative.project(pixel_grid(size, 16)[:, None], inverse_depths)
    return tracks, (ratio > 0) & (tracks >= 0).all(-1) & (tracks <= size[::-1]).all(-1)


def pixel_grid(size: tuple[int, int], cells: int) -> np.ndarray:
    """Return pixels [cells * cells, 2] evenly spread over an image of ``size`` (height, width)."""
    height, width = size
    fractions = (np.arange(cells) + 0.5) / cells
    u, v = np.meshgrid(fractions * width, fractions * height)
    return np.stack([u.ravel(), v.ravel()], 1)
