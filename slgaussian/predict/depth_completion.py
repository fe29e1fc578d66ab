"""From raw winners to a whole depth map: cross-view check, speckles, planes, weighted median."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from slgaussian.cameras.relative import Relative
from slgaussian.kernels.jit import kernel
from slgaussian.kernels.work_sharing import share, take
from slgaussian.predict.sgm import aggregate, winners

UNSEEN, AGREES, IN_FRONT, BEHIND = range(4)
"""What the other view says about a pixel's depth: outside its image; the same surface; a point
that the other view sees through; a point hidden behind what the other view sees."""

RELATIVE_TOLERANCE = 0.04
STEP_TOLERANCE = 1.5
"""How far inverse depths of two views may differ and still agree: a share of the depth, or this
many candidates, whichever is more."""

MAX_PLANES = 8
MIN_SUPPORT = 0.01
SQUARES = (8, 16, 32)
JUDGES = 4000
REFITTED = 10
REFITS = 15
"""Planes to look for; the least share of answered pixels on one; sides in pixels of the squares
whose planes are tried; about how many pixels judge them; how many of the best are refitted, and how
often. Sides of 12 and 32 or of 16 alone serve as well."""

MEDIAN_RADIUS = 7
MEDIAN_COLOR = 40.0
"""Window of the weighted median, and the colour difference (sum over RGB, 0 to 765) that counts as
one standard deviation."""

POTTS = 200
VOTE_STEPS = 3
FREE_SPACE = 30
"""Cost of a change of plane label in a flat part of the image; distance from a plane, in
candidates, where an answered pixel's vote against it is full (100); vote of an unanswered pixel
against a plane that another view sees through."""


def cross_check(
    inverse_depth: np.ndarray, other: np.ndarray, relative: Relative, step: float
) -> np.ndarray:
    """Compare a depth map with that of another view.

    Depths agree within :data:`RELATIVE_TOLERANCE` or :data:`STEP_TOLERANCE` candidates.

    Parameters
    ----------
    inverse_depth, other : float32 [H, W]
        Of the reference and of the source; ``other`` may be infinite where nothing is known, which
        reads as :data:`BEHIND`.
    relative : Relative
        From the reference to the source.
    step : float
        Distance between candidates.

    Returns
    -------
    uint8 [H, W]
        One of :data:`UNSEEN`, :data:`AGREES`, :data:`IN_FRONT`, :data:`BEHIND`.
    """
    return _cross_check(
        inverse_depth, other, relative.infinity, relative.epipole, STEP_TOLERANCE * step
    )


@kernel
def _cross_check(inverse_depth, other, A, e, least_tolerance):
    H, W = inverse_depth.shape
    out = np.empty((H, W), np.uint8)
    for y in range(H):
        for x in range(W):
            out[y, x] = _verdict(x, y, float(inverse_depth[y, x]), other, A, e, least_tolerance)
    return out


@kernel
def _verdict(x, y, w, other, A, e, least_tolerance):
    """What the other view says about inverse depth ``w`` at column ``x`` and row ``y``."""
    H, W = other.shape
    u, v = x + 0.5, y + 0.5
    z = A[2, 0] * u + A[2, 1] * v + A[2, 2] + w * e[2]
    if z <= 1e-9:
        return UNSEEN
    i = math.floor((A[1, 0] * u + A[1, 1] * v + A[1, 2] + w * e[1]) / z)
    j = math.floor((A[0, 0] * u + A[0, 1] * v + A[0, 2] + w * e[0]) / z)
    if not (0 <= i < H and 0 <= j < W):
        return UNSEEN
    here, seen = w / z, float(other[i, j])
    if abs(here - seen) <= max(RELATIVE_TOLERANCE * here, least_tolerance):
        return AGREES
    return IN_FRONT if here > seen else BEHIND


def without_speckles(index: np.ndarray, keep: np.ndarray, size: int) -> np.ndarray:
    """Drop from ``keep`` the connected patches of up to ``size`` pixels, bool [H, W].

    ``index`` float32 [H, W] counts candidates; neighbours within one belong together.
    """
    none = -32
    fixed = np.where(keep, np.round(index * 16), none).astype(np.int16)
    cv2.filterSpeckles(fixed, none, size, 16)
    return fixed != none


def fit_planes(inverse_depth: np.ndarray, keep: np.ndarray, tolerance: float) -> np.ndarray:
    """Planes of the scene, the one that most answered pixels lie on first, float64 [P, 3].

    At most :data:`MAX_PLANES`. A plane in space is linear in inverse depth: ``w = p @ (x, y, 1)``
    with x the column and y the row. Hypotheses are the least-squares planes of small squares of the
    image, at every place, so that nothing is drawn at random. The best few are refitted to what
    agrees with them, and the one that then explains most is taken; what it explains counts no
    more. Fewer than :data:`MIN_SUPPORT` of the answered pixels do not make a plane.

    Parameters
    ----------
    inverse_depth : float32 [H, W]
    keep : bool [H, W]
        The answered pixels.
    tolerance : float
        Largest residual of a pixel on the plane.
    """
    fewest = max(50, int(MIN_SUPPORT * keep.sum()))
    left = keep.copy()
    planes: list[np.ndarray] = []
    while len(planes) < MAX_PLANES:
        rows, columns = np.nonzero(left)
        if len(rows) < fewest:
            break
        guesses = np.concatenate([_square_planes(left, inverse_depth, size) for size in SQUARES])
        if not len(guesses):
            break
        stride = max(1, len(rows) // JUDGES)
        judges = slice(stride // 2, None, stride)
        y, x = rows[judges], columns[judges]
        points, w = np.stack([x, y, np.ones(len(x))], 1), inverse_depth[y, x].astype(np.float64)
        first = np.argsort(-_support(guesses, points, w, tolerance), kind="stable")[:REFITTED]
        refitted = np.stack([_refitted(plane, points, w, tolerance) for plane in guesses[first]])
        plane = refitted[_support(refitted, points, w, tolerance).argmax()]
        explained = left & (np.abs(_plane_depths(plane, *left.shape) - inverse_depth) < tolerance)
        if explained.sum() < fewest:
            break
        planes.append(plane)
        left &= ~explained
    return np.array(planes).reshape(-1, 3)


def _square_planes(keep: np.ndarray, inverse_depth: np.ndarray, size: int) -> np.ndarray:
    """Least-squares planes float64 [K, 3] of squares of ``size`` pixels, of those that are filled
    well enough to have one."""
    across = -(-keep.shape[1] // size)
    y, x = np.nonzero(keep)
    square = y // size * across + x // size
    numbers = np.arange(square.max() + 1)
    column, row = (numbers % across + 0.5) * size, (numbers // across + 0.5) * size
    u, v, w = x - column[square], y - row[square], inverse_depth[y, x].astype(np.float64)

    def summed(terms: np.ndarray) -> np.ndarray:
        return np.bincount(square, terms, len(numbers))

    count = summed(np.ones(len(u)))
    full = np.maximum(count, 1)
    mean_u, mean_v, mean_w = (summed(axis) / full for axis in (u, v, w))
    uu = summed(u * u) - count * mean_u * mean_u
    uv = summed(u * v) - count * mean_u * mean_v
    vv = summed(v * v) - count * mean_v * mean_v
    uw = summed(u * w) - count * mean_u * mean_w
    vw = summed(v * w) - count * mean_v * mean_w
    det = uu * vv - uv * uv
    good = (count >= size * size / 8) & (det > 1e-3 * (uu + vv) ** 2)
    det = np.where(good, det, 1.0)
    a, b = (vv * uw - uv * vw) / det, (uu * vw - uv * uw) / det
    return np.stack([a, b, mean_w - a * (mean_u + column) - b * (mean_v + row)], 1)[good]


def _refitted(plane: np.ndarray, points: np.ndarray, w: np.ndarray, tolerance: float) -> np.ndarray:
    """``plane`` fitted again and again to those of the points [M, 3] that agree with it."""
    for _ in range(REFITS):
        agrees = np.abs(points @ plane - w) < tolerance
        if agrees.sum() < 3:
            break
        plane = _through(points[agrees], w[agrees], plane)
    return plane


def _through(points: np.ndarray, w: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """The least-squares plane of points [M, 3] with inverse depths ``w``.

    By normal equations about their middle: three unknowns are not worth waking BLAS threads for.
    """
    middle, level = points.mean(0), w.mean()
    x, y, _ = (points - middle).T
    off = w - level
    xx, xy, yy = (x * x).sum(), (x * y).sum(), (y * y).sum()
    det = xx * yy - xy * xy
    if det <= 1e-9 * (xx + yy) ** 2:
        return plane
    a = (yy * (x * off).sum() - xy * (y * off).sum()) / det
    b = (xx * (y * off).sum() - xy * (x * off).sum()) / det
    return np.array([a, b, level - a * middle[0] - b * middle[1]])


@kernel
def _support(planes, points, w, tolerance):
    """Number of points near each plane, int64 [P]."""
    out = np.zeros(len(planes), np.int64)
    for k in range(len(planes)):
        a, b, c = planes[k]
        for i in range(len(points)):
            off = abs(a * points[i, 0] + b * points[i, 1] + c - w[i])
            out[k] += 1 if off < tolerance else 0
    return out


def _plane_depths(plane: np.ndarray, H: int, W: int) -> np.ndarray:
    """Inverse depth float32 [H, W] of a plane at every pixel."""
    column = np.arange(H)[:, None] * plane[1] + plane[2]
    return (column + np.arange(W) * plane[0]).astype(np.float32)


def fill(
    inverse_depth: np.ndarray,
    keep: np.ndarray,
    guide: np.ndarray,
    planes: np.ndarray,
    steps: np.ndarray,
    witnesses: Sequence[tuple[Relative, np.ndarray]],
) -> np.ndarray:
    """Give every unanswered pixel the inverse depth of one plane, float32 [H, W].

    A Potts model over plane labels decides which. Answered pixels vote for the planes near them.
    Unanswered ones have no photometric opinion (it is what failed there) but vote against planes
    that lie where another view sees through. Labels change where the guide image does. Without any
    plane the median of the answered pixels is taken, or the middle of the candidates.

    Parameters
    ----------
    inverse_depth : float32 [H, W]
    keep : bool [H, W]
        The answered pixels; they keep their value.
    guide : uint8 [H, W]
        Grey image.
    planes : float64 [P, 3]
        From :func:`fit_planes`.
    steps : float64 [D]
        Candidates; planes are clipped to their range.
    witnesses : sequence of (Relative, float32 [H, W])
        Other views: their geometry and inverse depth, infinite where unknown.
    """
    if not len(planes):
        level = np.median(inverse_depth[keep]) if keep.any() else steps[[0, -1]].mean()
        return np.where(keep, inverse_depth, np.float32(level))
    step = steps[1] - steps[0]
    votes = np.zeros((*keep.shape, len(planes)), np.uint8)
    levels = np.empty(votes.shape, np.float32)
    _vote(planes, inverse_depth, keep, steps[0], steps[-1], VOTE_STEPS * step, votes, levels)
    for relative, known in witnesses:
        A, e = relative.infinity, relative.epipole
        _vote_unseen(levels, keep, known, A, e, STEP_TOLERANCE * step, votes)
    label, _, _ = winners(aggregate(votes, guide, p1=POTTS, p2=POTTS))
    chosen = np.take_along_axis(levels, label[..., None].astype(np.int64), -1)[..., 0]
    return np.where(keep, inverse_depth, chosen)


@kernel
def _vote(planes, inverse_depth, keep, low, high, far, votes, levels):
    """Inverse depth of each plane at each pixel, and votes of answered pixels against planes."""
    H, W, P = votes.shape
    for y in range(H):
        for x in range(W):
            for k in range(P):
                a, b, c = planes[k]
                level = np.float32(min(max(a * x + b * y + c, low), high))
                levels[y, x, k] = level
                if keep[y, x]:
                    off = abs(level - inverse_depth[y, x]) / far
                    votes[y, x, k] = np.uint8(100 * min(off, 1.0))


@kernel
def _vote_unseen(levels, keep, other, A, e, least_tolerance, votes):
    """Votes of unanswered pixels against planes that the other view sees through."""
    H, W, P = votes.shape
    for y in range(H):
        for x in range(W):
            if not keep[y, x]:
                for k in range(P):
                    w = float(levels[y, x, k])
                    if _verdict(x, y, w, other, A, e, least_tolerance) == IN_FRONT:
                        votes[y, x, k] = FREE_SPACE


def weighted_median(
    inverse_depth: np.ndarray, image: np.ndarray, low: float, step: float
) -> np.ndarray:
    """Median of each window, weighted by likeness of colour to the centre, float32 [H, W].

    Moves depth edges onto colour edges and removes outliers (Ma et al., ICCV 2013). Every other
    pixel of the window counts, as the fields of one colour on a chessboard. The median is found in
    bins of half a candidate, then replaced by the weighted mean of the values within a candidate
    and a half of it: on a slope these lie evenly on both sides, so it stays one.

    Parameters
    ----------
    inverse_depth : float32 [H, W]
    image : uint8 [H, W, 3]
    low, step : float
        Least candidate and distance between candidates.
    """
    distance = np.arange(3 * 255 + 1) / MEDIAN_COLOR
    weights = np.exp(-0.5 * distance**2).astype(np.float32)
    bins = ((inverse_depth - low) / step * 2 + 0.5).clip(0).astype(np.int32)
    out = np.empty_like(inverse_depth)
    share(_weighted_median, len(out), inverse_depth, bins, bins.max() + 1, image, weights,
          MEDIAN_RADIUS, out)  # fmt: skip
    return out


@kernel
def _weighted_median(counter, values, bins, count, image, weights, radius, out):
    y = take(counter)
    while y < len(values):
        _median_row(values, bins, image, weights, radius, y, count, out[y])
        y = take(counter)


@kernel
def _median_row(values, bins, image, weights, radius, y, count, out):
    H, W = values.shape
    mass = np.zeros(count, np.float32)
    moment = np.zeros(count, np.float32)
    for x in range(W):
        r, g, b = np.int32(image[y, x, 0]), np.int32(image[y, x, 1]), np.int32(image[y, x, 2])
        centre = values[y, x]
        total = np.float32(0)
        least, most = count, 0
        # Every other pixel: half the time, and the same errors on real scenes.
        for j in range(max(y - radius, 0), min(y + radius + 1, H)):
            left = max(x - radius, 0)
            left += (left + x + j + y) % 2
            for i in range(left, min(x + radius + 1, W), 2):
                weight = weights[
                    abs(image[j, i, 0] - r) + abs(image[j, i, 1] - g) + abs(image[j, i, 2] - b)
                ]
                k = bins[j, i]
                mass[k] += weight
                # Relative to the centre: keeps float32 exact enough.
                moment[k] += weight * (values[j, i] - centre)
                total += weight
                least, most = min(least, k), max(most, k)
        below = np.float32(0)
        median = least
        for k in range(least, most + 1):
            below += mass[k]
            if 2 * below >= total:
                median = k
                break
        near, lever = np.float32(0), np.float32(0)
        for k in range(max(median - 3, least), min(median + 3, most) + 1):
            near += mass[k]
            lever += moment[k]
        out[x] = centre + lever / near
        mass[least : most + 1] = 0
        moment[least : most + 1] = 0
