"""Completion of a raw depth map: cross-view check, speckle removal, planes, weighted median."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from slgaussian.cameras.relative import Relative
from slgaussian.kernels.jit import kernel
from slgaussian.kernels.work_sharing import share, take
from slgaussian.predict.sgm import aggregate, select_winners

UNSEEN, AGREES, IN_FRONT, BEHIND = range(4)
"""Results of a cross-view check: outside the source image; the same surface; in front of the
source's surface, in its free space; behind the source's surface, occluded."""

# The constants of this file were chosen together, on the sets of which docs/measured/results.md
# says so, by the error of depth and of new views (python -m benches.predict.novel_view_error DATA).
# No page measures one of them alone; where a reason is known, it stands with the constant.

# Two views agree if their inverse depths differ by less than the larger of both: a share of the
# inverse depth, for errors of the cameras, which grow with it, and a number of candidate steps, as
# neither view is known better than its candidates.
RELATIVE_TOLERANCE = 0.04
STEP_TOLERANCE = 1.5

MAX_PLANES = 8
"""Largest number of planes of a view; each is a label of the Potts model, which takes its time."""
MIN_SUPPORT = 0.01
"""Smallest share of the answered pixels on a plane; below it, a plane fits what noise has left."""
SQUARE_SIDES = (8, 16, 32)
"""Sides of the squares that provide hypotheses, pixels: small ones lie on one surface, large ones
have the less noisy slopes."""
SCORING_PIXELS = 4000
"""Approximate number of answered pixels, taken evenly, that score hypotheses and refit planes."""
REFITTED_PLANES = 10
"""Number of refitted hypotheses: the best square need not grow into the best plane."""
REFITS = 15
"""Number of refits of a hypothesis to its inliers, which change with it."""

MEDIAN_RADIUS = 7
"""Half the side of the window of the weighted median, pixels."""
MEDIAN_COLOUR = 40.0
"""Standard deviation of the colour weight: sum of absolute differences over RGB, 0 to 765."""

# Costs of semi-global matching are bytes. An answered pixel costs 0 on its plane and 100 where its
# plane is SATURATION_STEPS candidate steps off or more, which bounds what an outlier can cost.
SATURATION_STEPS = 3
POTTS_COST = 200
"""Cost of a change of plane label in a uniform part of the image: that of two outliers. Aggregation
lowers it at steps of grey, where surfaces end."""
FREE_SPACE_COST = 30
"""Cost of an unanswered pixel on a plane that lies in the free space of another view. Below that of
an outlier, as that view may be wrong too."""


def cross_check(
    inverse_depth: np.ndarray, source_depth: np.ndarray, relative: Relative, step: float
) -> np.ndarray:
    """Compare a depth map with that of another view.

    Depths agree within :data:`RELATIVE_TOLERANCE` or :data:`STEP_TOLERANCE` candidates.

    Args:
        inverse_depth, source_depth: float32 [H, W]. Inverse depth of the reference and of the
            source. Infinity marks unknown depth of the source and results in :data:`BEHIND`.
        relative: From the reference to the source.
        step: Distance between depth candidates.

    Returns:
        uint8 [H, W]: One of :data:`UNSEEN`, :data:`AGREES`, :data:`IN_FRONT`, :data:`BEHIND`.
    """
    A, e = relative.infinity, relative.epipole
    out = np.empty(inverse_depth.shape, np.uint8)
    share(_cross_check, len(out), inverse_depth, source_depth, A, e, STEP_TOLERANCE * step, out)
    return out


@kernel
def _cross_check(counter, inverse_depth, source_depth, A, e, least_tolerance, out):
    # A point (u, v) with inverse depth w is seen in the other view at A (u, v, 1) + w e, times its
    # depth here (A: homography of the plane at infinity, e: epipole; Hartley and Zisserman 2004,
    # chapter 9). Its third number z is the ratio of both depths, so that the other view has inverse
    # depth w / z. The nearest pixel is read, not a mean: that of two surfaces lies on neither.
    H, W = inverse_depth.shape
    y = take(counter)
    while y < H:
        for x in range(W):
            out[y, x] = UNSEEN
            u, v, w = x + 0.5, y + 0.5, float(inverse_depth[y, x])
            z = A[2, 0] * u + A[2, 1] * v + A[2, 2] + w * e[2]
            if z <= 1e-9:
                continue
            i = math.floor((A[1, 0] * u + A[1, 1] * v + A[1, 2] + w * e[1]) / z)
            j = math.floor((A[0, 0] * u + A[0, 1] * v + A[0, 2] + w * e[0]) / z)
            if not (0 <= i < source_depth.shape[0] and 0 <= j < source_depth.shape[1]):
                continue
            inverse, observed = w / z, float(source_depth[i, j])
            if abs(inverse - observed) <= max(RELATIVE_TOLERANCE * inverse, least_tolerance):
                out[y, x] = AGREES
            else:
                out[y, x] = IN_FRONT if inverse > observed else BEHIND
        y = take(counter)


def remove_speckles(index: np.ndarray, keep: np.ndarray, size: int) -> np.ndarray:
    """Drop from ``keep`` the connected patches of up to ``size`` pixels, bool [H, W].

    ``index`` float32 [H, W] counts candidates; neighbours within one belong together.
    """
    # cv2.filterSpeckles takes int16: sixteenths of a candidate, and what is dropped is farther than
    # one candidate from all others.
    none = -32
    fixed = np.where(keep, np.round(index * 16), none).astype(np.int16)
    cv2.filterSpeckles(fixed, none, size, 16)
    return fixed != none


def fit_planes(inverse_depth: np.ndarray, keep: np.ndarray, tolerance: float) -> np.ndarray:
    """Fit planes to the answered pixels one after the other, float64 [P, 3].

    A plane in space is linear in inverse depth: ``w = p @ (x, y, 1)`` with x the column and y the
    row. Hypotheses are the least-squares planes of all squares of a grid. The best are refitted to
    their inliers, and the one with most inliers is accepted; its inliers are removed before the
    next is sought.

    Args:
        inverse_depth: float32 [H, W]
        keep: bool [H, W]. The answered pixels.
        tolerance: Largest residual of a pixel on the plane.
    """
    fewest = max(50, int(MIN_SUPPORT * keep.sum()))
    # One plane at a time, the largest first: what it explains does not vote for the next one, so
    # that a second plane is not the first one again, tilted by noise.
    left = keep.copy()
    planes: list[np.ndarray] = []
    while len(planes) < MAX_PLANES:
        rows, columns = np.nonzero(left)
        if len(rows) < fewest:
            break
        guesses = np.concatenate(
            [_square_planes(rows, columns, inverse_depth, size) for size in SQUARE_SIDES]
        )
        if not len(guesses):
            break
        # Evenly, not at random, so that the result depends on the photographs alone.
        stride = max(1, len(rows) // SCORING_PIXELS)
        judges = slice(stride // 2, None, stride)
        y, x = rows[judges], columns[judges]
        points, w = np.stack([x, y, np.ones(len(x))], 1), inverse_depth[y, x].astype(np.float64)
        first = np.argsort(-_support(guesses, points, w, tolerance), kind="stable")[
            :REFITTED_PLANES
        ]
        refitted = _refit(guesses[first], points, w, tolerance)
        plane = refitted[_support(refitted, points, w, tolerance).argmax()]
        explained = left & (np.abs(_plane_depths(plane, *left.shape) - inverse_depth) < tolerance)
        if explained.sum() < fewest:
            break
        planes.append(plane)
        left &= ~explained
    return np.array(planes).reshape(-1, 3)


def _square_planes(
    y: np.ndarray, x: np.ndarray, inverse_depth: np.ndarray, size: int
) -> np.ndarray:
    """Fit planes [K, 3] to squares of ``size`` pixels with enough of the pixels (``x``, ``y``)."""
    across = -(-inverse_depth.shape[1] // size)
    square = y // size * across + x // size
    numbers = np.arange(square.max() + 1)
    column, row = (numbers % across + 0.5) * size, (numbers // across + 0.5) * size
    # Relative to the middle of each square: raw moments of pixels far from the origin would lose
    # their digits in the differences of the normal equations.
    terms = _moments(x - column[square], y - row[square], inverse_depth[y, x].astype(np.float64))
    sums = np.stack([np.bincount(square, term, len(numbers)) for term in terms])
    planes, roundness = _planes_of_moments(sums)
    planes[:, 2] -= planes[:, 0] * column + planes[:, 1] * row
    return planes[(sums[0] >= size * size / 8) & (roundness > 1e-3)]


def _refit(planes: np.ndarray, points: np.ndarray, w: np.ndarray, tolerance: float) -> np.ndarray:
    """Refit planes [P, 3] to their inliers among the points [M, 3]; without BLAS, whose last digit
    depends on threads."""
    # Inliers of the last fit decide the next one; a
    # plane whose inliers are collinear keeps its last fit.
    x, y, _ = points.T
    middle_x, middle_y = x.mean(), y.mean()
    terms = np.stack(_moments(x - middle_x, y - middle_y, w))
    for _ in range(REFITS):
        a, b, c = planes.T[..., None]
        inliers = np.abs(a * x + b * y + c - w) < tolerance
        fitted, roundness = _planes_of_moments(np.einsum("pm,km->kp", inliers * 1.0, terms))
        fitted[:, 2] -= fitted[:, 0] * middle_x + fitted[:, 1] * middle_y
        planes = np.where(roundness[:, None] > 1e-9, fitted, planes)
    return planes


def _moments(u: np.ndarray, v: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the terms whose sums over points :func:`_planes_of_moments` takes."""
    return np.ones_like(u), u, v, w, u * u, u * v, v * v, u * w, v * w


def _planes_of_moments(sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solve centred normal equations for planes ``w = p @ (u, v, 1)`` [P, 3] from sums [9, P].

    Also returns determinant over squared trace of the scatter of the points [P]: 0 where they are
    collinear or none, 0.25 in a disc.
    """
    # Steiner: central moments are those about the origin less count times the product of means.
    # Then Cramer's rule for the 2x2 system of a and b; c follows from the means.
    count, u, v, w, uu, uv, vv, uw, vw = sums
    mean_u, mean_v, mean_w = (axis / np.maximum(count, 1) for axis in (u, v, w))
    uu, uv, vv = uu - u * mean_u, uv - u * mean_v, vv - v * mean_v
    uw, vw = uw - u * mean_w, vw - v * mean_w
    det = uu * vv - uv * uv
    roundness = det / np.maximum((uu + vv) ** 2, 1e-30)
    det = np.where(roundness > 0, det, 1.0)
    a, b = (vv * uw - uv * vw) / det, (uu * vw - uv * uw) / det
    return np.stack([a, b, mean_w - a * mean_u - b * mean_v], 1), roundness


@kernel
def _support(planes, points, w, tolerance):
    """Count the inliers of each plane, int64 [P]."""
    out = np.zeros(len(planes), np.int64)
    for k in range(len(planes)):
        a, b, c = planes[k]
        for i in range(len(points)):
            residual = abs(a * points[i, 0] + b * points[i, 1] + c - w[i])
            out[k] += 1 if residual < tolerance else 0
    return out


def _plane_depths(plane: np.ndarray, H: int, W: int) -> np.ndarray:
    """Return the inverse depth of a plane at every pixel, float32 [H, W]."""
    column = np.arange(H)[:, None] * plane[1] + plane[2]
    return (column + np.arange(W) * plane[0]).astype(np.float32)


def fill_depth(
    inverse_depth: np.ndarray,
    keep: np.ndarray,
    guide: np.ndarray,
    planes: np.ndarray,
    steps: np.ndarray,
    witnesses: Sequence[tuple[Relative, np.ndarray]],
) -> np.ndarray:
    """Assign the inverse depth of one plane to every unanswered pixel, float32 [H, W].

    A Potts model over plane labels, minimised by semi-global matching, selects the plane. The data
    term of an answered pixel is its distance from the plane; that of another penalises planes in
    the free space of another view. Without any plane the median of the answered pixels is assigned,
    or the middle of the candidates.

    Args:
        inverse_depth: float32 [H, W]
        keep: bool [H, W]. The answered pixels; they keep their value.
        guide: uint8 [H, W]. Grey image.
        planes: float64 [P, 3]. From :func:`fit_planes`.
        steps: float64 [D]. Candidates; planes are clipped to their range.
        witnesses: sequence of (Relative, float32 [H, W]). Relative pose and inverse depth of other
            views, infinite where unknown.
    """
    if not len(planes):
        level = np.median(inverse_depth[keep]) if keep.any() else steps[[0, -1]].mean()
        return np.where(keep, inverse_depth, np.float32(level))
    step = steps[1] - steps[0]
    y, x = np.indices(keep.shape)
    levels = np.stack([(a * x + b * y + c).clip(steps[0], steps[-1]) for a, b, c in planes])
    levels = levels.astype(np.float32)
    residual = np.minimum(np.abs(levels - inverse_depth) / (SATURATION_STEPS * step), 1)
    votes = np.where(keep, 100 * residual, 0).astype(np.uint8)
    for relative, source_depth in witnesses:
        for level, vote in zip(levels, votes, strict=True):
            verdict = cross_check(level, source_depth, relative, step)
            vote[~keep & (verdict == IN_FRONT)] = FREE_SPACE_COST
    # With both penalties equal, semi-global matching is a Potts model: planes have no order in
    # which a step to the next one would be small.
    votes = np.ascontiguousarray(votes.transpose(1, 2, 0))
    label, _, _ = select_winners(aggregate(votes, guide, p1=POTTS_COST, p2=POTTS_COST))
    chosen = np.take_along_axis(levels, label[None].astype(np.int64), 0)[0]
    return np.where(keep, inverse_depth, chosen)


def weighted_median(
    inverse_depth: np.ndarray, image: np.ndarray, low: float, step: float
) -> np.ndarray:
    """Filter with a median weighted by colour similarity to the window's centre, float32 [H, W].

    Moves depth edges onto colour edges and removes outliers (Ma et al., ICCV 2013). The median of a
    histogram with bins of half a candidate is replaced by the weighted mean of the values within
    one and a half candidates of it, which preserves slopes.

    Args:
        inverse_depth: float32 [H, W]
        image: uint8 [H, W, 3]
        low, step: Smallest candidate and distance between candidates.
    """
    distance = np.arange(3 * 255 + 1) / MEDIAN_COLOUR
    weights = np.exp(-0.5 * distance**2).astype(np.float32)
    bins = ((inverse_depth - low) / step * 2 + 0.5).clip(0).astype(np.int32)
    out = np.empty_like(inverse_depth)
    share(_weighted_median, len(out), inverse_depth, bins, bins.max() + 1, image, weights,
          MEDIAN_RADIUS, out)  # fmt: skip
    return out


@kernel
def _weighted_median(counter, values, bins, count, image, weights, radius, out):
    # A histogram of weights over bins of half a candidate gives the median without sorting; its
    # bins are cleared only where they were filled. ``moment`` has the sums of weighted values.
    H, W = values.shape
    mass = np.zeros(count, np.float32)
    moment = np.zeros(count, np.float32)
    y = take(counter)
    while y < H:
        for x in range(W):
            r, g, b = np.int32(image[y, x, 0]), np.int32(image[y, x, 1]), np.int32(image[y, x, 2])
            centre = values[y, x]
            total = np.float32(0)
            first_bin, last_bin = count, 0
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
                    first_bin, last_bin = min(first_bin, k), max(last_bin, k)
            below, median = np.float32(0), first_bin - 1
            while 2 * below < total and median < last_bin:
                median += 1
                below += mass[median]
            near, lever = np.float32(0), np.float32(0)
            for k in range(max(median - 3, first_bin), min(median + 3, last_bin) + 1):
                near += mass[k]
                lever += moment[k]
            out[y, x] = centre + lever / near
            mass[first_bin : last_bin + 1] = 0
            moment[first_bin : last_bin + 1] = 0
        y = take(counter)
