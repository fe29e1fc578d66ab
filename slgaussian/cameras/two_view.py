"""Relative pose of two photographs, with a verdict on it.

A pose is refused if it has too little support, or if another pose is about as good: photographs
taken from one position, of one plane, or of different places also have matches, and any estimator
returns a pose for them. The bounds were chosen on the pairs of `docs/measured/poses.md`, so that
hardly any wrong pose is reported as good.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from slgaussian.cameras.epipolar import FocalPrior, TwoViews, solve
from slgaussian.cameras.estimated import DOUBTFUL, GOOD, UNUSED, EstimatedPair
from slgaussian.cameras.matches import Features, find_features, match
from slgaussian.cameras.subpixel import sharpen
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
    """A photograph with its grey image uint8 [h, w] and its features."""

    photograph: Photograph
    grey: np.ndarray
    features: Features

    @staticmethod
    def of(photograph: Photograph) -> Described:
        """Detect the features of a photograph."""
        grey = cv2.cvtColor(photograph.image, cv2.COLOR_RGB2GRAY)
        return Described(photograph, grey, find_features(grey, MAX_FEATURES, CONTRAST_THRESHOLD))

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
        if self.photograph.focal is None:
            return float(np.log(FOCAL_MEAN * self.longer)), FOCAL_STD
        return float(np.log(self.photograph.focal * self.shrunk)), EXIF_FOCAL_STD

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
        advice: Advice in that case, a clause.
        probability: Probability of the pose among all solutions.
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
    if prior is None:
        mean, sigma = np.array([a.focal, b.focal]).T
        prior = FocalPrior(mean, sigma, shared=a.lens == b.lens)
    i, j, ratios = match(a.features, b.features, POSE_LOWE_RATIO)
    order = np.argsort(ratios, kind="stable")
    i, j = i[order], j[order]
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
        return _refused(
            all_matches.of(flat),
            *(_flaw_of_points(all_matches.of(flat), MIN_PLANAR_COVER, max) or degenerate),
        )
    pose = replace(all_matches.of(inlier), views=best)
    if count < max(MIN_INLIERS, MIN_INLIER_SHARE * len(i)):
        return _refuse_few(pose)
    if (flaw := _flaw_of_points(pose, MIN_COVER, min)) is not None:
        return _refused(pose, *flaw)
    assert best.covariance is not None
    # Standard deviation of rotation or direction, over all axes together.
    uncertainty = float(np.degrees(np.sqrt(np.trace(best.covariance[:5, :5]))))
    angle = float(np.median(best.angles(pose.x, pose.y)))
    probability = _probability(answers)
    measured = replace(pose.estimate, angle=angle, uncertainty=uncertainty)
    pose = replace(pose, estimate=measured, probability=probability)
    mostly_flat = flat.sum() > MAX_HOMOGRAPHY_SHARE * count
    if probability < (DOUBTFUL_PROBABILITY if mostly_flat else REFUSED_PROBABILITY):
        return _refused(
            pose,
            "different positions of the cameras explain the matches about as well, as happens with "
            "repeated patterns, flat things and little overlap",
            "take photographs that share more, with things at different distances in both",
        )
    open_position = f"the matches leave the position open by {uncertainty:.0f} degrees"
    if uncertainty > REFUSED_UNCERTAINTY:
        advice = "take photographs that share more, from a step farther apart"
        return _refused(pose, open_position, advice)
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
    return replace(pose, estimate=replace(pose.estimate, verdict=DOUBTFUL, said="; ".join(doubts)))


def confidence(pose: PairPose) -> float:
    """Compute the probability, 0 to 1, that a pose is right to a few degrees."""
    if pose.estimate.verdict == UNUSED or pose.views is None:
        return 0.0
    enough = 1 - np.exp(-pose.estimate.inliers / MIN_INLIERS)
    certain = np.exp(-0.5 * (pose.estimate.uncertainty / REFUSED_UNCERTAINTY) ** 2)
    return float(pose.probability * enough * certain)


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


def _refused(pose: PairPose, reason: str, advice: str) -> PairPose:
    estimate = replace(pose.estimate, verdict=UNUSED, said=reason)
    return replace(pose, estimate=estimate, advice=advice)


def _refuse_few(pose: PairPose) -> PairPose:
    """Refuse a pair with too few agreeing matches."""
    matches = pose.estimate.matches
    return _refused(
        pose,
        f"too few points are found that both show ({pose.estimate.inliers} of {matches} matches "
        f"agree, expected {MIN_INLIERS} or more)",
        "take sharp photographs of one place that overlap by half or more, a step apart",
    )
