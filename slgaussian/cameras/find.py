"""Estimate cameras from photographs alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import minimum_spanning_tree

from slgaussian.cameras import two_view
from slgaussian.cameras.epipolar import CORRELATED_MATCHES
from slgaussian.cameras.estimated import DOUBTFUL, UNUSED, EstimatedCameras, EstimatedPair, Focal
from slgaussian.cameras.incremental import Placed, Tie, place
from slgaussian.cameras.lens_errors import SUSPECT_WRONG, LensEvidence, combine, interval
from slgaussian.cameras.match_graph import MatchGraph
from slgaussian.cameras.matches import match
from slgaussian.cameras.two_view import EXIF_FOCAL_STD, Described, PairPose, Photograph, confidence
from slgaussian.copies import Thumbnail, are_copies
from slgaussian.errors import InputError, join_names
from slgaussian.scene import Camera, Estimated

FOCAL_STD_FACTOR, FOCAL_STD_FLOOR = 2.0, 0.04
"""The loss underestimates errors of matches, and no lens is a true pinhole: the deviation of a log
focal length is multiplied by ``FOCAL_STD_FACTOR``, and ``FOCAL_STD_FLOOR`` is added in quadrature.
Chosen so that about 90 % of the true focal lengths of the pairs and chains of
`docs/measured/poses.md` lie in the interval."""

DOUBTFUL_CONFIDENCE = 0.8
"""Confidence below which cameras of three or more photographs are reported as doubtful."""

DOUBTFUL_PAIR_FACTOR = 0.85
"""Factor of the confidence in a pair whose cameras are doubtful: of 28 doubtful pairs, 20
photographed and 8 rendered with two focal lengths (``docs/measured/poses.md``), 4 were wrong."""

NARROWED_STD_RATIO = 0.8
"""The source of a focal length is "matches" if its deviation is below this fraction of the prior's.
"""

COARSE_FEATURES = 800
"""Number of features, the largest of a photograph, for the quick selection of pairs."""

NEIGHBOURS = 3
"""Number of photographs with which each is solved, those with most matches."""

MIN_CONFIDENCE = 0.5
"""Cameras of less confidence are refused."""

UNSUPPORTED_FACTOR = 0.6
"""Factor of the confidence if no reliable pair supports a placed photograph: such placements were
right on two chains of a walk, and wrong where two rooms contained the same object."""

MIN_BASELINE_RATIO = 1e-3
"""Smallest distance of the first two cameras, the unit of length, over the largest distance."""


Solve = Callable[[Described, Described], PairPose]
"""Estimation of a pair: :func:`slgaussian.cameras.two_view.find_pair`."""


class Unplaced(InputError):
    """Some photographs cannot be placed among the others.

    Attributes:
        left_out: mapping str -> str. Reason, a clause, by name of the photograph.
    """

    def __init__(self, left_out: Mapping[str, str]) -> None:
        self.left_out = left_out
        super().__init__(
            f"{join_names([left_out])} cannot be placed among the other photographs: "
            f"{next(iter(left_out.values()))}; leave out what shows another place, or take "
            "photographs between that overlap both by half or more"
        )


def find_cameras(photographs: Sequence[Photograph]) -> EstimatedCameras:
    """Estimate the cameras of two or more photographs.

    The same photographs give the same cameras; their order determines only the world frame.
    Photographs that cannot be placed are left out if they are the minority. Of the copies of one
    picture only the largest stays, the first of several.

    Raises:
        InputError: If the estimation fails; the message names the photographs, the reason and what
            to do.
    """
    originals: dict[str, Thumbnail] = {}
    left: dict[str, str] = {}
    for photograph in sorted(photographs, key=lambda item: -item.width * item.height):
        picture = Thumbnail.of(photograph.image)
        same = (name for name, other in originals.items() if are_copies(other, picture))
        if (first := next(same, None)) is None:
            originals[photograph.name] = picture
        else:
            left[photograph.name] = f"it is the same picture as {first}"
    if len(originals) < 2:
        name, reason = next(iter(left.items()))
        raise InputError(
            f"{name!r}: {reason}, and no other photograph is left; depth needs a photograph of the "
            "same things from a step aside"
        )
    once = [photograph for photograph in photographs if photograph.name in originals]
    described = [Described.of(photograph) for photograph in once]
    solve = cache(two_view.find_pair)
    remaining = described
    while True:
        try:
            estimated = (_find_two if len(remaining) == 2 else find_multi_view)(remaining, solve)
            break
        except Unplaced as gap:
            remaining = [item for item in remaining if item.photograph.name not in gap.left_out]
            if 2 * len(remaining) <= len(described):
                raise
            left |= gap.left_out
    left = {p.name: left[p.name] for p in photographs if p.name in left}
    warnings = tuple(f"{name} is left out: {why}" for name, why in left.items())
    return replace(estimated, warnings=(*warnings, *estimated.warnings), left_out=left)


def _find_two(described: Sequence[Described], solve: Solve) -> EstimatedCameras:
    a, b = described
    first, second = sorted(described, key=lambda item: item.digest)
    reverse = first is not a
    (first, second), poses = settle_lenses([first, second], [(0, 1)], solve)
    pose = poses[0, 1]
    views = pose.views
    if pose.estimate.verdict == UNUSED or views is None or views.covariance is None:
        raise InputError(
            f"{a.photograph.name!r} and {b.photograph.name!r}: no cameras can be found: "
            f"{pose.estimate.reason}; {pose.advice}"
        )
    R, t, focals, deviations = views.R, views.t, views.focals, pose.deviations
    described = [first, second]
    if reverse:
        R, t = R.T, -R.T @ t
        focals, deviations, described = focals[::-1], deviations[::-1], [second, first]
    pair = replace(pose.estimate, views=(a.photograph.name, b.photograph.name))
    doubtful = pair.verdict == DOUBTFUL
    probability = confidence(pose) * (DOUBTFUL_PAIR_FACTOR if doubtful else 1)
    doubt = pair.reason if doubtful else ""
    placed = np.stack([np.eye(3), R]), np.stack([np.zeros(3), t])
    estimate = _estimated_cameras(
        described, *placed, focals, deviations, (pair,), probability, doubt
    )
    graph = _graph([first, second], poses).select([1, 0] if reverse else [0, 1])
    return replace(estimate, matches=graph)


def find_multi_view(described: Sequence[Described], solve: Solve) -> EstimatedCameras:
    """Estimate the cameras of three or more photographs.

    They are processed in the order of their digests, so the order of the arguments determines only
    the world frame.

    Raises:
        Unplaced: If some cannot be placed, or not with enough confidence.
        InputError: If none can be placed, or the first two are at one position.
    """
    order = sorted(range(len(described)), key=lambda k: described[k].digest)
    ordered = [described[k] for k in order]
    ordered, poses = settle_lenses(ordered, worth_solving(ordered), solve)
    described = [ordered[rank] for rank in np.argsort(order)]
    priors: dict[object, tuple[float, float]] = {}
    for item in ordered:
        priors.setdefault(item.lens, item.focal)
    lenses = list(priors)
    mean, sigma = np.array(list(priors.values())).T
    solved = {views: pose for views, pose in poses.items() if len(pose.i) >= two_view.MIN_INLIERS}
    placed = place(
        _refined_keypoints(ordered, solved),
        np.array([item.middle for item in ordered]),
        np.array([lenses.index(item.lens) for item in ordered]),
        np.exp(mean),
        sigma,
        [_tie(views, pose) for views, pose in solved.items()],
    )
    _require_places(ordered, poses, placed)
    assert placed is not None
    bundle = placed.adjusted.bundle
    index_of = np.argsort(placed.order)[np.argsort(order)]
    R, t = bundle.R[index_of], bundle.t[index_of]
    R = R @ R[0].T
    t = t - R @ t[0]
    distances = np.linalg.norm(t, axis=1)
    scale = float(distances[1])
    if scale < MIN_BASELINE_RATIO * distances.max():
        first, second = (item.photograph.name for item in described[:2])
        raise InputError(
            f"{first!r} and {second!r}: taken from one place, but the distance of the first two is "
            "the unit of length; leave one out, or put it last"
        )
    pairs = {views: _check_pair(pose, placed, views, order) for views, pose in poses.items()}
    probability = _confidence(ordered, placed, pairs)
    lens = bundle.group[index_of]
    deviations = placed.adjusted.focal_deviations[lens]
    doubtful = probability < DOUBTFUL_CONFIDENCE
    doubt = "some photographs share little with the others" if doubtful else ""
    estimate = _estimated_cameras(
        described,
        R,
        t / scale,
        bundle.focals[lens],
        deviations,
        tuple(pairs.values()),
        probability,
        doubt,
    )
    graph = _graph(ordered, solved).select([int(rank) for rank in np.argsort(order)])
    return replace(estimate, matches=graph)


def _refined_keypoints(
    described: Sequence[Described], poses: Mapping[tuple[int, int], PairPose]
) -> list[np.ndarray]:
    """Return the keypoints of each image, pixels; inliers of poses where they were refined to."""
    keypoints = [item.features.points.copy() for item in described]
    for (_, second), pose in reversed(list(poses.items())):
        keypoints[second][pose.j] = pose.y + pose.second.middle
    return keypoints


def _graph(described: Sequence[Described], poses: Mapping[tuple[int, int], PairPose]) -> MatchGraph:
    """Return the matches of solved pairs, in pixels of the whole photographs."""
    keypoints = []
    for item, points in zip(described, _refined_keypoints(described, poses), strict=True):
        whole = np.array([item.photograph.width, item.photograph.height])
        keypoints.append(points * (whole / (2 * item.middle)))
    return MatchGraph(keypoints, {views: pose.matches for views, pose in poses.items()})


def settle_lenses(
    described: Sequence[Described], pairs: Sequence[tuple[int, int]], solve: Solve
) -> tuple[list[Described], dict[tuple[int, int], PairPose]]:
    """Solve pairs, and again if they contradict EXIF or show that lenses are distorted.

    Returns:
        The photographs with what all pairs say about their lenses, and the poses of pairs.
    """
    poses = {(i, j): solve(described[i], described[j]) for i, j in pairs}
    evidences: dict[object, list[LensEvidence]] = {item.lens: [] for item in described}
    for views, pose in poses.items():
        for lens, evidence in {
            described[view].lens: each for view, each in zip(views, pose.lenses or (), strict=False)
        }.items():
            evidences[lens].append(evidence)
    by_lens = {lens: combine(evidence) for lens, evidence in evidences.items() if evidence}
    settled = [
        item.settle(by_lens[item.lens]) if item.lens in by_lens else item for item in described
    ]
    if any(
        after.focal != before.focal or (after.settled and after.settled.bend[0])
        for before, after in zip(described, settled, strict=True)
    ):
        poses = {
            (i, j): replace(solve(settled[i], settled[j]), rivals=pose.rivals)
            for (i, j), pose in poses.items()
        }
    return settled, poses


def worth_solving(described: Sequence[Described]) -> list[tuple[int, int]]:
    """Select the pairs (i, j), i < j, with most matches, enough to connect all photographs.

    All pairs are matched with few features; only the selected pairs are matched in full.
    """
    subsets = []
    for item in described:
        largest = np.argsort(-item.features.scales, kind="stable")[:COARSE_FEATURES]
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
    return Tie(views, (pose.i, pose.j), pose.views, angle, confidence(pose))


def _require_places(
    described: Sequence[Described], poses: dict[tuple[int, int], PairPose], placed: Placed | None
) -> None:
    """Raise InputError if no photograph was placed, Unplaced if some were not."""
    if placed is None:
        best = max(poses.values(), key=lambda pose: pose.estimate.inliers)
        a, b = best.estimate.views
        raise InputError(
            f"{len(described)} photographs: no two of them tell cameras; {a!r} and {b!r} share most"
            f", but {best.estimate.reason or 'hold too little that both show'}; "
            f"{best.advice or 'take photographs that share more'}"
        )
    placed_views = set(placed.order.tolist())
    names = [item.photograph.name for item in described]
    left = [k for k in range(len(described)) if k not in placed_views]
    if left:
        raise Unplaced({names[k]: _unplaced_reason(names[k], k, poses, placed_views) for k in left})


def _unplaced_reason(
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
    reason = best.reason or f"only {best.inliers} matches agree, too few of which others show"
    return f"of it and {neighbour!r}, which shares most with it: {reason}"


def _check_pair(
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
    if pose.views.turned_from(together) < two_view.SAME_POSE_ANGLE:
        return estimate
    return replace(
        estimate, verdict=UNUSED, reason="the other photographs contradict what the two say alone"
    )


def _confidence(
    described: Sequence[Described], placed: Placed, pairs: Mapping[tuple[int, int], EstimatedPair]
) -> float:
    """Compute the probability, 0 to 1, that every pose is right to a few degrees.

    It is lower if a view has no reliable pair that agrees with the joint solution.

    Raises:
        Unplaced: If it is below :data:`MIN_CONFIDENCE`.
    """
    adjusted = placed.adjusted
    distances = np.linalg.norm(adjusted.bundle.t, axis=1)
    distances /= distances.max()
    deviations = []
    for view in range(1, len(distances)):
        rotation, direction = adjusted.degrees(view)
        # The direction between two of several photographs at one position is arbitrary.
        deviations += [rotation, direction * distances[view]]
    uncertainty = CORRELATED_MATCHES**0.5 * max(deviations)
    counts = np.bincount(adjusted.bundle.view)
    probability = float(
        (1 - np.exp(-counts.min() / two_view.MIN_INLIERS))
        * np.exp(-0.5 * (uncertainty / two_view.REFUSED_UNCERTAINTY) ** 2)
    )
    supported = {view for views, pair in pairs.items() if pair.verdict != UNUSED for view in views}
    if len(supported) < len(described):
        probability *= UNSUPPORTED_FACTOR
    if probability < MIN_CONFIDENCE:
        weakest = int(counts.argmin())
        name = described[placed.order[weakest]].photograph.name
        raise Unplaced(
            {
                name: f"it shares too little with them ({counts[weakest]} points, which leave "
                f"positions open by {uncertainty:.0f} degrees)"
            }
        )
    return probability


def _estimated_cameras(
    described: Sequence[Described], R: np.ndarray, t: np.ndarray, focals: np.ndarray,
    deviations: np.ndarray, pairs: tuple[EstimatedPair, ...], probability: float, doubt: str,
) -> EstimatedCameras:  # fmt: skip
    """Return cameras of whole photographs from poses [V, 3, 3] and [V, 3], world to camera, focal
    lengths [V], pixels of the images, and deviations [V] of their logarithms."""
    cameras, by_name = {}, {}
    for k, item in enumerate(described):
        photograph = item.photograph
        focal = estimate_focal(focals[k] / item.shrunk, float(deviations[k]), item)
        f, width, height = focal.pixels, photograph.width, photograph.height
        c2w = np.eye(4)
        c2w[:3, :3], c2w[:3, 3] = R[k].T, -R[k].T @ t[k]
        by_name[photograph.name] = focal
        cameras[photograph.name] = Camera(
            np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]]), c2w, width, height,
            estimated=Estimated((focal.low / f, focal.high / f), focal.source, probability),
        )  # fmt: skip
    notes = _lens_warnings(described, by_name)
    bends = {item.photograph.name: item.bend for item in described}
    distortions = {
        name: bend * (by_name[name].pixels / max(cameras[name].width, cameras[name].height)) ** 2
        for name, bend in bends.items()
        if bend
    }
    return EstimatedCameras(cameras, by_name, pairs, probability, doubt, notes, {}, distortions)


def _lens_warnings(described: Sequence[Described], focals: Mapping[str, Focal]) -> tuple[str, ...]:
    """Return a sentence on each lens that the matches contradict."""
    notes = {}
    for item in described:
        photograph = item.photograph
        focal = focals[photograph.name]
        if photograph.focal is not None and item.exif_probability < 1 - SUSPECT_WRONG:
            assert item.settled is not None
            matched = np.exp(item.settled.focal[0]) / item.shrunk
            used = "EXIF is used" if item.priors.exif else "EXIF is not used"
            notes[item.lens, "EXIF"] = (
                f"{photograph.name}: EXIF gives a focal length of {photograph.focal:.0f} pixels, "
                f"but the matches {matched:.0f}; {used}, and {focal.low:.0f} to {focal.high:.0f} "
                "is likely; is the photograph cropped or edited? give cameras to be sure"
            )
        if item.bend:
            notes[item.lens, "bend"] = (
                f"{photograph.name}: the lens bends straight lines; a distortion of k1 = "
                f"{item.bend * (focal.pixels * item.shrunk / item.longer) ** 2:.2f} is estimated "
                "from the matches and removed; calibrated cameras are more accurate"
            )
    return tuple(notes.values())


def estimate_focal(pixels: float, deviation: float, item: Described) -> Focal:
    """Return the focal length of the whole photograph with its interval, from the standard
    deviation of its logarithm. Where EXIF may be wrong, the interval is that of both answers."""
    priors = item.priors
    by_exif = priors.exif is not None
    spread = min(_add_model_error(deviation), item.focal[1])
    narrowed = spread < NARROWED_STD_RATIO * two_view.FOCAL_STD
    components = [(1.0, float(np.log(pixels)), spread)]
    if item.photograph.focal is not None and item.settled is not None:
        right, mean = item.exif_probability, item.settled.focal[0] - np.log(item.shrunk)
        without = min(_add_model_error(item.settled.focal[1]), priors.typical[1])
        rival = (mean, without) if by_exif else (np.log(item.photograph.focal), EXIF_FOCAL_STD)
        share = right if by_exif else 1 - right
        components = [(share, *components[0][1:]), (1 - share, *rival)]
    low, high = np.exp(interval(components, 0.05)).tolist()
    source = "EXIF" if by_exif else "matches" if narrowed else "guess"
    return Focal(float(pixels), min(low, float(pixels)), max(high, float(pixels)), source)


def _add_model_error(deviation: float) -> float:
    return float(np.hypot(FOCAL_STD_FACTOR * deviation, FOCAL_STD_FLOOR))
