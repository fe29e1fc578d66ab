"""Cameras of three or more photographs: selection of pairs, and estimation from the pairs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import minimum_spanning_tree

from slgaussian.cameras.epipolar import COUPLING
from slgaussian.cameras.estimated import UNUSED, EstimatedPair
from slgaussian.cameras.incremental import Placed, Tie, place
from slgaussian.cameras.matches import match
from slgaussian.cameras.two_view import ALIKE, BLUNT, LEAST, Described, PairPose, confidence
from slgaussian.errors import InputError, listed
from slgaussian.io import short_repr

COARSE = 800
"""Number of features, the largest of a photograph, for the quick selection of pairs."""

NEIGHBOURS = 3
"""Number of photographs with which each is solved, those with most matches."""

MIN_CONFIDENCE = 0.5
"""Cameras of less confidence are refused."""

UNBACKED = 0.6
"""Factor of the confidence if no reliable pair supports a placed photograph: such placements were
right on two chains of a walk, and wrong where two rooms contained the same object."""

STILL = 1e-3
"""Smallest distance of the first two cameras, the unit of length, over the largest distance."""


Solve = Callable[[Described, Described], PairPose]
"""Estimation of a pair: :func:`slgaussian.cameras.two_view.find_pair`."""


@dataclass(frozen=True, eq=False)
class PlacedCameras:
    """Cameras of photographs, in their order, in the frame of the first.

    Attributes:
        R, t: float64 [V, 3, 3], [V, 3]. World to camera; the first two are at distance 1.
        focals, deviations: float64 [V]. Focal lengths in pixels of the images, and standard
            deviations of their logarithms.
        pairs: tuple of EstimatedPair. All solved pairs.
    """

    R: np.ndarray
    t: np.ndarray
    focals: np.ndarray
    deviations: np.ndarray
    pairs: tuple[EstimatedPair, ...]
    confidence: float

    __repr__ = short_repr


class Unplaced(InputError):
    """Some photographs cannot be placed among the others.

    Attributes:
        left_out: mapping str -> str. Reason, a clause, by name of the photograph.
    """

    def __init__(self, left_out: Mapping[str, str]) -> None:
        self.left_out = left_out
        super().__init__(
            f"{listed([left_out])} cannot be placed among the other photographs: "
            f"{next(iter(left_out.values()))}; leave out what shows another place, or take "
            "photographs between that overlap both by half or more"
        )


def find_multi_view(described: Sequence[Described], solve: Solve) -> PlacedCameras:
    """Estimate the cameras of three or more photographs.

    They are processed in the order of their digests, so the order of the arguments determines only
    the world frame.

    Raises:
        Unplaced: If some cannot be placed, or not with enough confidence.
        InputError: If none can be placed, or the first two are at one position.
    """
    order = sorted(range(len(described)), key=lambda k: described[k].digest)
    ordered = [described[k] for k in order]
    poses = {(i, j): solve(ordered[i], ordered[j]) for i, j in worth_solving(ordered)}
    priors: dict[object, tuple[float, float]] = {}
    for item in ordered:
        priors.setdefault(item.lens, item.focal)
    lenses = list(priors)
    mean, sigma = np.array(list(priors.values())).T
    placed = place(
        [item.features.points for item in ordered],
        np.array([item.middle for item in ordered]),
        np.array([lenses.index(item.lens) for item in ordered]),
        np.exp(mean),
        sigma,
        [_tie(views, pose) for views, pose in poses.items() if len(pose.i) >= LEAST],
    )
    _all_placed(ordered, poses, placed)
    assert placed is not None
    bundle = placed.adjusted.bundle
    back = np.argsort(placed.order)[np.argsort(order)]
    R, t = bundle.R[back], bundle.t[back]
    R = R @ R[0].T
    t = t - R @ t[0]
    distances = np.linalg.norm(t, axis=1)
    scale = float(distances[1])
    if scale < STILL * distances.max():
        first, second = (item.photograph.name for item in described[:2])
        raise InputError(
            f"{first!r} and {second!r}: taken from one place, but the distance of the first two is "
            "the unit of length; leave one out, or put it last"
        )
    pairs = {views: _checked(pose, placed, views, order) for views, pose in poses.items()}
    sure = _confidence(ordered, placed, pairs)
    lens = bundle.group[back]
    return PlacedCameras(
        R,
        t / scale,
        bundle.focals[lens],
        placed.adjusted.focal_deviations[lens],
        tuple(pairs.values()),
        sure,
    )


def worth_solving(described: Sequence[Described]) -> list[tuple[int, int]]:
    """Select the pairs (i, j), i < j, with most matches, enough to connect all photographs.

    All pairs are matched with few features; only the selected pairs are matched in full.
    """
    subsets = []
    for item in described:
        largest = np.argsort(-item.features.scales, kind="stable")[:COARSE]
        subsets.append(item.features[largest])
    count = len(subsets)
    shared = np.zeros((count, count))
    for i in range(count):
        for j in range(i + 1, count):
            shared[i, j] = shared[j, i] = len(match(subsets[i], subsets[j], 0.85)[0])
    pairs = {(i, int(j)) for i in range(count) for j in np.argsort(-shared[i])[:NEIGHBOURS]}
    tree = minimum_spanning_tree(csr_array(1 / (1 + shared) * ~np.eye(count, dtype=bool)))
    pairs |= set(zip(*map(np.ndarray.tolist, tree.nonzero()), strict=True))
    return sorted({(min(i, j), max(i, j)) for i, j in pairs if i != j})


def _tie(views: tuple[int, int], pose: PairPose) -> Tie:
    """Make the tie of a pair; without a pose if the pair is degenerate (one position, or a plane).

    A third photograph may show the same points from another position.
    """
    angle = float(np.nan_to_num(pose.estimate.angle))
    xy = pose.y + pose.second.middle
    return Tie(views, (pose.i, pose.j), xy, pose.views, angle, confidence(pose))


def _all_placed(
    described: Sequence[Described],
    poses: dict[tuple[int, int], PairPose],
    placed: Placed | None,
) -> None:
    """Raise InputError if no photograph was placed, Unplaced if some were not."""
    if placed is None:
        best = max(poses.values(), key=lambda pose: pose.estimate.inliers)
        a, b = best.estimate.views
        raise InputError(
            f"{len(described)} photographs: no two of them tell cameras; {a!r} and {b!r} share most"
            f", but {best.estimate.said or 'hold too little that both show'}; "
            f"{best.advice or 'take photographs that share more'}"
        )
    placed_views = set(placed.order.tolist())
    names = [item.photograph.name for item in described]
    left = [k for k in range(len(described)) if k not in placed_views]
    if left:
        raise Unplaced({names[k]: _why_unplaced(names[k], k, poses, placed_views) for k in left})


def _why_unplaced(
    name: str, view: int, poses: Mapping[tuple[int, int], PairPose], placed_views: Set[int]
) -> str:
    """Return a clause: why a view is not placed, judged by its best pair with a placed view."""
    candidates = [
        pose for views, pose in poses.items() if view in views and placed_views & {*views}
    ]
    if not candidates:
        return "it shares next to nothing with them"
    best = max(candidates, key=lambda pose: pose.estimate.inliers).estimate
    neighbour = best.views[best.views[0] == name]
    reason = best.said or f"only {best.inliers} matches agree, too few of which others show"
    return f"of it and {neighbour!r}, which shares most with it: {reason}"


def _checked(
    pose: PairPose, placed: Placed, views: tuple[int, int], order: Sequence[int]
) -> EstimatedPair:
    """Return the estimate of a pair in input order, UNUSED if the joint solution contradicts it."""
    estimate = pose.estimate
    if order[views[0]] > order[views[1]]:
        estimate = replace(estimate, views=(estimate.views[1], estimate.views[0]))
    if pose.views is None or estimate.verdict == UNUSED:
        return estimate
    a, b = (placed.order.tolist().index(view) for view in views)
    bundle = placed.adjusted.bundle
    R = bundle.R[b] @ bundle.R[a].T
    t = bundle.t[b] - R @ bundle.t[a]
    together = replace(pose.views, R=R, t=t / max(float(np.linalg.norm(t)), 1e-12))
    if pose.views.turned_from(together) < ALIKE:
        return estimate
    return replace(
        estimate, verdict=UNUSED, said="the other photographs contradict what the two say alone"
    )


def _confidence(
    described: Sequence[Described],
    placed: Placed,
    pairs: Mapping[tuple[int, int], EstimatedPair],
) -> float:
    """Compute the probability, 0 to 1, that every pose is right to a few degrees.

    It is lower if a view has no reliable pair that agrees with the joint solution.

    Raises:
        Unplaced: If it is below :data:`MIN_CONFIDENCE`.
    """
    adjusted = placed.adjusted
    far = np.linalg.norm(adjusted.bundle.t, axis=1)
    far /= far.max()
    off = []
    for view in range(1, len(far)):
        turned, moved = adjusted.degrees(view)
        # The direction between two of several photographs at one position is arbitrary.
        off += [turned, moved * far[view]]
    worst = COUPLING**0.5 * max(off)
    counts = np.bincount(adjusted.bundle.view)
    sure = float((1 - np.exp(-counts.min() / LEAST)) * np.exp(-0.5 * (worst / BLUNT) ** 2))
    backed = {view for views, pair in pairs.items() if pair.verdict != UNUSED for view in views}
    if len(backed) < len(described):
        sure *= UNBACKED
    if sure < MIN_CONFIDENCE:
        fewest = int(counts.argmin())
        name = described[placed.order[fewest]].photograph.name
        raise Unplaced(
            {
                name: f"it shares too little with them ({counts[fewest]} points, which leave "
                f"positions open by {worst:.0f} degrees)"
            }
        )
    return sure
