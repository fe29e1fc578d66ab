"""Relative pose of two photographs, with a verdict on it.

A pose is refused if it has too little support, or if another pose is about as good: photographs
taken from one position, of one plane, or of different places also have matches, and any estimator
returns a pose for them. The bounds were chosen on the pairs of `docs/measured/poses.md`, so that
hardly any wrong pose is reported as good.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np

from slgaussian.cameras.epipolar import FocalPrior, TwoViews, solve, widen
from slgaussian.cameras.estimated import DOUBTFUL, GOOD, UNUSED, EstimatedPair
from slgaussian.cameras.lens_errors import (
    EXIF_WRONG,
    MIN_WRONG,
    Lens,
    LensEvidence,
    assume,
    update,
    weigh,
)
from slgaussian.cameras.matches import LOWE_RATIO, Features, find_features, match
from slgaussian.cameras.subpixel import sharpen
from slgaussian.datasets.lens import lens_maps, unfold
from slgaussian.io import short_repr

MAX_IMAGE_SIDE = 1200
"""Longer side, pixels, to which readers shrink the images for feature detection."""

MAX_FEATURES, CONTRAST_THRESHOLD, POSE_LOWE_RATIO = 6000, 0.01, 0.85
"""SIFT features, contrast and Lowe's ratio; dark and plain walls have few strong features."""

FOCAL_MEAN, FOCAL_STD = 0.8, 0.3
"""Typical focal length of phones and cameras over the longer side, and standard deviation of its
logarithm."""

EXIF_FOCAL_STD = 0.05
"""Standard deviation of the log focal length by EXIF: some phones crop, some round."""

MIN_INLIERS = 20
MIN_INLIER_SHARE = 0.2
"""Smallest number and fraction of inliers; by chance up to a dozen matches agree."""

DOUBTFUL_PROBABILITY, REFUSED_PROBABILITY = 0.95, 0.8
"""Probability of the poses within :data:`SAME_POSE_ANGLE` of the best, among all solutions, below
which a pair is doubtful, and refused."""

MAX_HOMOGRAPHY_SHARE = 0.85
"""Fraction of inliers on one homography above which a doubtful pair is refused: few matches remain
to determine the position."""

SAME_POSE_ANGLE = 10.0
"""Degrees."""

DOUBTFUL_UNCERTAINTY, REFUSED_UNCERTAINTY = 3.0, 6.0
"""Uncertainty, degrees, above which a pair is doubtful, and refused (``SAME_POSE_ANGLE``: same
pose)."""

MIN_COVER, MIN_PLANAR_COVER = 0.02, 0.2
"""Smallest fraction of a photograph that the inliers must cover: of each photograph, and of one of
them if all inliers fit one homography."""

ZOOM_RATIO = 1.4
"""Scale ratio from which on a pair without known focal lengths is doubtful: it may be a zoom."""

REPETITION_SAMPLES, REPETITION_LIMIT = 200, 0.85
"""Approximate number of inliers tested for repetition, and largest :func:`_repetition`."""

STILL_DISTANCE, MIN_MOVED_DISTANCE = 0.5, 6.0
"""Distance, pixels, below which a match is at one place in both photographs; and smallest median
distance of the others if these are marks on the photographs."""

MIN_SIDE, BLANK_DEVIATION = 64, 2.0
"""Smallest side of a photograph, pixels, and smallest standard deviation of its grey values."""

SEPARATE_POINT_DISTANCE = 8.0
"""Distance, in units of the feature's scale, from which on two features are separate points."""

DEGENERATE_RATIO, HOMOGRAPHY_DISTANCE = 0.92, 2.0
"""Ratio of inliers of a homography, within ``HOMOGRAPHY_DISTANCE`` pixels, to inliers of the pose
from which on a pair is degenerate: photographs taken from one place, or of one plane, leave
positions open."""


@dataclass(frozen=True, eq=False)
class Photograph:
    """One upright photograph and the lens information of its file.

    Attributes:
        name: Unique among the photographs of one call.
        image: uint8 [h, w, 3]. RGB; may be smaller than the photograph, with the same aspect ratio.
        width, height: Size of the whole photograph, upright, pixels.
        lens: Identifies the lens: maker, model, lens and focal length by EXIF; "" if unknown.
            Photographs of one size and one lens share a focal length.
        focal: Focal length by EXIF, pixels of the whole photograph.
    """

    name: str
    image: np.ndarray
    width: int
    height: int
    lens: str = ""
    focal: float | None = None

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Described:
    """A photograph with its grey image uint8 [h, w] and its features.

    Attributes:
        settled: What all pairs say about the lens, if that is known; its distortion is removed from
            image and features.
    """

    photograph: Photograph
    grey: np.ndarray
    features: Features
    settled: LensEvidence | None = None

    @staticmethod
    def of(photograph: Photograph) -> Described:
        """Detect the features of a photograph."""
        grey = cv2.cvtColor(photograph.image, cv2.COLOR_RGB2GRAY)
        return Described(photograph, grey, find_features(grey, MAX_FEATURES, CONTRAST_THRESHOLD))

    def settle(self, evidence: LensEvidence) -> Described:
        """Return the photograph with what its matches say about the lens, undistorted."""
        bend, item = evidence.bend[0], self
        if bend:
            K = np.diag([self.longer, self.longer, 1.0])
            K[:2, 2] = self.middle
            maps = unfold(*lens_maps(K, (2 * self.middle).astype(int).tolist(), (bend,)))
            image = cv2.remap(self.photograph.image, *maps, cv2.INTER_LINEAR)
            item = Described.of(replace(self.photograph, image=image))
        return replace(item, settled=evidence)

    @cached_property
    def digest(self) -> str:
        """Return the SHA-256 of the image, by which photographs are ordered."""
        return hashlib.sha256(np.ascontiguousarray(self.photograph.image).data).hexdigest()

    @property
    def middle(self) -> np.ndarray:
        """Return the principal point float64 [2]: the image centre, pixels of the image."""
        height, width = self.photograph.image.shape[:2]
        return np.array([width, height]) / 2

    @property
    def longer(self) -> int:
        """Return the longer side of the image, pixels."""
        return max(self.photograph.image.shape[:2])

    @property
    def shrunk(self) -> float:
        """Return the size of the image over that of the whole photograph."""
        return self.longer / max(self.photograph.width, self.photograph.height)

    @property
    def focal(self) -> tuple[float, float]:
        """Return the prior of the log focal length, pixels of the image: mean and deviation."""
        priors = self.priors
        return priors.typical if priors.exif is None else priors.exif

    @property
    def bend(self) -> float:
        """Return the distortion that was removed from the image, 0 without."""
        return 0.0 if self.settled is None else self.settled.bend[0]

    @property
    def exif_probability(self) -> float:
        """Return the probability that the focal length by EXIF is right."""
        return 1 - (0.0 if self.settled is None else update(EXIF_WRONG, self.settled.wrong))

    @property
    def priors(self) -> Lens:
        """Return the priors of the lens; EXIF that the matches contradict is left out."""
        mean, exif = float(np.log(FOCAL_MEAN * self.longer)), None
        typical = mean, FOCAL_STD
        if self.photograph.focal is not None:
            stated = float(np.log(self.photograph.focal * self.shrunk))
            # Other focal lengths than typical ones are likelier if EXIF has such.
            typical = mean, max(FOCAL_STD, abs(stated - mean) / 2)
            exif = (stated, EXIF_FOCAL_STD) if self.exif_probability > 1 - MIN_WRONG else None
        if self.settled is None:
            return Lens(self.longer, exif, typical)
        return Lens(self.longer, exif, typical, self.settled.bend[1], open=False)

    @property
    def lens(self) -> tuple[str, int, int, float | None]:
        """Return the identity of the lens; photographs with equal values share a focal length."""
        photograph = self.photograph
        shorter, longer = sorted((photograph.width, photograph.height))
        return photograph.lens, shorter, longer, photograph.focal


@dataclass(frozen=True, eq=False)
class PairPose:
    """Relative pose of two photographs, if their matches determine one.

    Attributes:
        views: Image coordinates are pixels from the image centres.
        i, j: int [M]. Indices of the inlier features.
        x, y: float64 [M, 2]. Their positions, pixels from the image centres; ``y`` is refined to
            sub-pixel accuracy.
        estimate: ``estimate.verdict`` is UNUSED if the pose must not be used.
        lenses: What the matches say about the two lenses; None if nothing.
        advice: Advice in that case, a clause.
        probability: Probability of the pose among all solutions.
        rivals: list of (float, TwoViews). Probability and solution of each assumption on lenses.
        deviations: float64 [2]. Standard deviations of the log focal lengths, if the distortion is
            unknown.
        matches: (int [N], int [N]). All matches that pass :data:`LOWE_RATIO`, right or wrong.
    """

    first: Described
    second: Described
    views: TwoViews | None
    i: np.ndarray
    j: np.ndarray
    x: np.ndarray
    y: np.ndarray
    estimate: EstimatedPair
    advice: str = ""
    probability: float = 1.0
    lenses: tuple[LensEvidence, LensEvidence] | None = None
    rivals: Sequence[tuple[float, TwoViews]] = ()
    deviations: np.ndarray = field(default_factory=lambda: np.zeros(2))
    matches: tuple[np.ndarray, np.ndarray] = (np.zeros(0, int), np.zeros(0, int))

    def of(self, mask: np.ndarray) -> PairPose:
        """Return the pose with the inliers restricted to ``mask``, bool [M]."""
        estimate = replace(self.estimate, inliers=int(mask.sum()))
        i, j, x, y = (values[mask] for values in (self.i, self.j, self.x, self.y))
        return replace(self, i=i, j=j, x=x, y=y, estimate=estimate)


def find_pair(a: Described, b: Described, prior: FocalPrior | None = None) -> PairPose:
    """Match two photographs and estimate their relative pose; the verdict states a refusal.

    Args:
        a, b: The result for (b, a) is the inverse pose, up to rounding.
        prior: Prior of the two focal lengths, pixels of the images; default from EXIF or typical
            lenses.
    """
    i, j, ratios = match(a.features, b.features, POSE_LOWE_RATIO)
    order = np.argsort(ratios, kind="stable")
    i, j, reliable = i[order], j[order], ratios[order] < LOWE_RATIO

    def find_pose(used: np.ndarray) -> PairPose:
        pose, good = _pose_from_matches(a, b, i[used], j[used], prior), used & reliable
        return replace(pose, matches=(i[good], j[good]))

    pose = find_pose(np.ones(len(i), bool))
    moved = np.linalg.norm(a.features.points[i] - b.features.points[j], axis=1)
    still = moved < STILL_DISTANCE
    if pose.estimate.verdict != UNUSED or still.sum() < MIN_INLIERS or still.all():
        return pose
    # Marks on the photographs themselves agree with cameras that do not move.
    scene = find_pose(~still)
    if scene.estimate.inliers < MIN_INLIERS or np.median(moved[~still]) < MIN_MOVED_DISTANCE:
        return pose
    if scene.estimate.verdict != UNUSED:
        return scene
    return _refuse(
        pose,
        f"{still.sum()} of {len(i)} matches are at the same pixels in both, as the marks of a "
        "status bar or a watermark are, and the others do not determine the cameras",
        "crop away what was drawn over the photographs",
    )


def _pose_from_matches(
    a: Described, b: Described, i: np.ndarray, j: np.ndarray, prior: FocalPrior | None
) -> PairPose:
    """Estimate the relative pose from matching features int [M], the most reliable first."""
    lenses, shared, is_given = (a.priors, b.priors), a.lens == b.lens, prior is not None
    if prior is None:
        prior = assume(lenses, shared)
    x = a.features.points[i] - a.middle
    y = sharpen((a.grey, b.grey), a.features, b.features, i, j) - b.middle
    names = a.photograph.name, b.photograph.name
    estimate = EstimatedPair(names, len(i), 0, np.nan, np.nan, GOOD, "")
    all_matches = PairPose(a, b, None, i, j, x, y, estimate)
    answers = solve(x, y, prior)
    if not answers:
        return _refuse_few(all_matches.of(np.zeros(len(i), bool)))
    best = answers[0]
    inlier = best.inliers(x, y, 3 * best.scale)
    count = int(inlier.sum())
    flat = _on_homography(x, y)
    if flat.sum() >= DEGENERATE_RATIO * max(count, MIN_INLIERS):
        degenerate = (
            "they were taken from one place, or nearly all that both show is one flat thing",
            "take the second photograph from a step sideways, with things at different distances",
        )
        # A shared crop or plane must fill one of the two photographs.
        return _refuse(
            all_matches.of(flat),
            *(_flaw_of_points(all_matches.of(flat), MIN_PLANAR_COVER, max) or degenerate),
        )
    if not is_given:
        bent = assume(lenses, shared, (False, False, True))
        deviations = widen(best, x, y, bent).deviations(bent)[0]
        all_matches = replace(all_matches, deviations=deviations)
        if a.settled is None:
            evidences, rivals = weigh(lenses, shared, x, y, best)
            all_matches = replace(all_matches, lenses=evidences, rivals=rivals)
    pose = replace(all_matches.of(inlier), views=best)
    if count < max(MIN_INLIERS, MIN_INLIER_SHARE * len(i)):
        return _refuse_few(pose)
    if (flaw := _flaw_of_points(pose, MIN_COVER, min)) is not None:
        return _refuse(pose, *flaw)
    assert best.covariance is not None
    # Standard deviation of rotation or direction, over all axes together.
    uncertainty = float(np.degrees(np.sqrt(np.trace(best.covariance[:5, :5]))))
    angle = float(np.median(best.angles(pose.x, pose.y)))
    probability = _probability(answers)
    measured = replace(pose.estimate, angle=angle, uncertainty=uncertainty)
    pose = replace(pose, estimate=measured, probability=probability)
    mostly_flat = flat.sum() > MAX_HOMOGRAPHY_SHARE * count
    if probability < (DOUBTFUL_PROBABILITY if mostly_flat else REFUSED_PROBABILITY):
        return _refuse(
            pose,
            "different positions of the cameras explain the matches about as well, as happens with "
            "repeated patterns, flat things and little overlap",
            "take photographs that share more, with things at different distances in both",
        )
    open_position = f"the matches leave the position open by {uncertainty:.0f} degrees"
    if uncertainty > REFUSED_UNCERTAINTY:
        advice = "take photographs that share more, from a step farther apart"
        return _refuse(pose, open_position, advice)
    doubts = []
    if probability < DOUBTFUL_PROBABILITY:
        doubts.append("another position of the cameras would explain the matches almost as well")
    if uncertainty > DOUBTFUL_UNCERTAINTY:
        doubts.append(open_position)
    if count < 2 * MIN_INLIERS:
        doubts.append(f"only {count} matches agree")
    zoom = np.median(np.log(b.features.scales[pose.j] / a.features.scales[pose.i]))
    larger = float(np.exp(abs(zoom)))
    if prior.sigma.max() > EXIF_FOCAL_STD and larger > ZOOM_RATIO:
        doubts.append(
            f"things are {larger:.1f} times as large in one, by a zoom or a step forward, and no "
            "EXIF says which"
        )
    if not doubts:
        return pose
    return replace(
        pose, estimate=replace(pose.estimate, verdict=DOUBTFUL, reason="; ".join(doubts))
    )


def confidence(pose: PairPose) -> float:
    """Compute the probability, 0 to 1, that a pose is right to a few degrees."""
    if pose.estimate.verdict == UNUSED or pose.views is None:
        return 0.0
    enough = 1 - np.exp(-pose.estimate.inliers / MIN_INLIERS)
    certain = np.exp(-0.5 * (pose.estimate.uncertainty / REFUSED_UNCERTAINTY) ** 2)
    other = sum(p for p, end in pose.rivals if end.turned_from(pose.views) > SAME_POSE_ANGLE)
    return float(pose.probability * enough * certain * (1 - other))


def _on_homography(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Find the matches [M, 2] and [M, 2] that fit the homography with most inliers: bool [M]."""
    try:
        _, inliers = cv2.findHomography(
            x, y, cv2.USAC_ACCURATE, HOMOGRAPHY_DISTANCE, None, 2000, 0.999
        )
    except cv2.error:
        inliers = None
    return np.zeros(len(x), bool) if inliers is None else inliers.ravel() > 0


def _probability(answers: list[TwoViews]) -> float:
    """Compute the probability of the best pose and those like it, among all solutions."""
    odds = np.exp([answers[0].cost - answer.cost for answer in answers])
    near = np.array([answer.turned_from(answers[0]) < SAME_POSE_ANGLE for answer in answers])
    return float(odds[near].sum() / odds.sum())


def _flaw_of_points(
    pose: PairPose, min_share: float, which: Callable[[float, float], float]
) -> tuple[str, str] | None:
    """Return a flaw in the distribution of the inliers, with advice; None if there is none."""
    if which(_cover(pose.x, pose.first), _cover(pose.y, pose.second)) < min_share:
        return (
            "all points that both show lie in one small part of a photograph",
            "take photographs that share more of what they show",
        )
    if _repetition(pose) > REPETITION_LIMIT:
        return (
            "what both show is a pattern that repeats, and fits itself in several ways",
            "take photographs that also show things that are there only once",
        )
    return None


def _repetition(pose: PairPose) -> float:
    """Return the median over inliers of the distance to the match over the distance to the nearest
    other feature of the first photograph: near 1 for repeated patterns."""
    features = pose.first.features
    sample = slice(None, None, 1 + len(pose.i) // REPETITION_SAMPLES)
    i, j = pose.i[sample], pose.j[sample]
    descriptors = features.descriptors[i]
    matched = (descriptors * pose.second.features.descriptors[j]).sum(1)
    likeness = descriptors @ features.descriptors.T
    # One point can have several features, of different orientations or scales.
    far = np.linalg.norm(features.points[i][:, None] - features.points, axis=2)
    likeness[far < SEPARATE_POINT_DISTANCE * features.scales[i][:, None]] = -1
    second_best = likeness.max(1)
    return float(np.median(np.sqrt((2 - 2 * matched).clip(0) / (2 - 2 * second_best).clip(1e-9))))


def _cover(points: np.ndarray, of: Described) -> float:
    """Compute the fraction of the image that the convex hull of points [M, 2] covers."""
    height, width = of.photograph.image.shape[:2]
    return cv2.contourArea(cv2.convexHull(points.astype(np.float32))) / (height * width)


def _refuse(pose: PairPose, reason: str, advice: str) -> PairPose:
    estimate = replace(pose.estimate, verdict=UNUSED, reason=reason)
    return replace(pose, estimate=estimate, advice=advice)


def _refuse_few(pose: PairPose) -> PairPose:
    """Refuse a pair with too few agreeing matches."""
    matches = pose.estimate.matches
    for item in (pose.first, pose.second):
        name, (height, width) = item.photograph.name, item.grey.shape
        if min(height, width) < MIN_SIDE:
            return _refuse(
                pose,
                f"{name!r} has {width}x{height} pixels, too few to find points in",
                f"give photographs of {MIN_SIDE} pixels or more on each side",
            )
        if item.grey.std() < BLANK_DEVIATION:
            look = "black" if item.grey.mean() < 16 else "blank"
            return _refuse(pose, f"{name!r} is {look}", "leave it out, or take it again")
    return _refuse(
        pose,
        f"too few points are found that both show ({pose.estimate.inliers} of {matches} matches "
        f"agree, expected {MIN_INLIERS} or more)",
        "take sharp photographs of one place that overlap by half or more, a step apart",
    )
