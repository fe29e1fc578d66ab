"""Check given cameras against the feature matches of their photographs.

With correct cameras, a match lies near its epipolar line and its point in front of both cameras;
with exchanged poses, other axes or another focal length most matches do not. Matches may also be
wrong, on repeated patterns or where two photographs share nothing. Therefore cameras are judged
only if enough matches are inliers of some fundamental matrix, whichever cameras it stands for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from slgaussian.cameras.match_graph import match_views
from slgaussian.cameras.relative import Relative
from slgaussian.errors import InputError
from slgaussian.scene import Camera, Sample, View

COARSE_DISTANCE = 0.01
FINE_DISTANCE = 0.002
"""Distances to the epipolar line, as fractions of the image diagonal, up to which cameras explain a
match: 7 and 1.4 pixels at 416x576. Poses of phones and headsets are often off by half a degree,
which the coarse distance tolerates and :mod:`slgaussian.predict.pose_refinement` corrects. The fine
distance compares several candidate cameras."""

MIN_FINE_DISTANCE = 1.0
"""Smallest fine distance, pixels: small photographs do not have more accurate matches."""

MIN_AGREEING = 30
MIN_AGREEMENT = 0.4
"""Smallest number and fraction of matches that must agree with each other to judge cameras."""

MIN_EXPLAINED = 0.35
"""Cameras are refused if they explain less than this fraction of the agreeing matches."""

MIN_CORRECTED = 0.6
MIN_GAIN = 2.0
"""A correction is reported if, within the fine distance, it explains at least ``MIN_CORRECTED`` of
the agreeing matches and ``MIN_GAIN`` times as many as the uncorrected cameras. Both were chosen by
the measurements in `docs/measured/earlier.md`."""

WIDE_TRIANGULATION_ANGLE = 20.0
"""Angle between the two lines of sight to a point, degrees, above which depth errors grow."""

WIDE_AXIS_ANGLE = 30.0
"""Angle between two optical axes, degrees, above which depth errors grow."""

Pair = tuple[Camera, Camera]


@dataclass(frozen=True)
class PairCheck:
    """Agreement of the matches of two photographs with the cameras.

    Attributes:
        views: (str, str)
        agreeing: Number of matches that agree with each other.
        coarse: Fraction of all matches that the cameras explain within ``pixels``, the coarse
            distance for this image size.
        angle: Degrees between the two lines of sight, median of the explained matches; NaN without
            any.
        correction: Advice of the correction that makes the cameras fit, if there is one.
        precise: Fraction of the matches that agree within the fine distance that the cameras
            explain within it; 1 if too few agree.
    """

    views: tuple[str, str]
    matches: int
    agreeing: int
    coarse: float
    pixels: float
    angle: float
    correction: str | None = None
    precise: float = 1.0

    @property
    def judged(self) -> bool:
        """Tell whether enough matches agree with each other to judge the cameras."""
        return enough(self.matches, self.agreeing)

    @property
    def refuted(self) -> bool:
        """Tell whether the matches contradict the cameras."""
        too_few = self.coarse * self.matches < MIN_EXPLAINED * self.agreeing
        return self.judged and (too_few or self.correction is not None)


def enough(matches: int, agreeing: int) -> bool:
    """Tell whether enough matches agree with each other to judge cameras."""
    return agreeing >= max(MIN_AGREEING, MIN_AGREEMENT * matches)


def refuse(scene: str, checks: Sequence[PairCheck], estimated: bool = False) -> None:
    """Raise InputError if the matches of a pair refute its cameras.

    The message gives the correction if the cause is a common mistake. For ``estimated`` cameras it
    advises to take other photographs.
    """
    refuted = [check for check in checks if check.refuted]
    if refuted:
        worst = min(refuted, key=lambda check: check.coarse)
        raise InputError(f"scene {scene!r}: {_refusal(worst, estimated)}")


def check_pairs(sample: Sample) -> list[PairCheck]:
    """Check the cameras of the pairs of context views that connect all, in the order of the pairs.

    They form a maximum spanning tree of the agreeing matches. Most pairs of views along a walk show
    nothing in common, and their matches are wrong. A pair without enough agreement is used only to
    connect a view that has no other edge in the tree so far.
    """
    views, graph = sample.context, match_views(sample)
    checks = {(i, j): check_pair(views[i], views[j], *graph.points(i, j)) for i, j in graph.matches}
    piece = {view: {view} for pair in checks for view in pair}
    selected = []
    for pair in sorted(checks, key=lambda p: (-checks[p].agreeing, -checks[p].matches, p)):
        first, second = (piece[view] for view in pair)
        if first is not second and (checks[pair].judged or 1 in (len(first), len(second))):
            selected.append(pair)
            first |= second
            piece |= dict.fromkeys(second, first)
    return [checks[pair] for pair in sorted(selected)]


def check_pair(a: View, b: View, at_a: np.ndarray, at_b: np.ndarray) -> PairCheck:
    """Check two cameras against the matches [M, 2] and [M, 2] of their photographs, pixels."""
    diagonal = float(np.hypot(*a.grey.shape))
    coarse, fine = COARSE_DISTANCE * diagonal, max(FINE_DISTANCE * diagonal, MIN_FINE_DISTANCE)
    pair = a.camera, b.camera
    agreeing, finely = (int(agree(at_a, at_b, far).sum()) for far in (coarse, fine))
    near = explain(*pair, at_a, at_b, coarse)
    check = PairCheck(
        views=(a.name, b.name),
        matches=len(at_a),
        agreeing=agreeing,
        coarse=float(near.mean()) if len(near) else 0.0,
        pixels=coarse,
        angle=float(np.median(angles(*pair, at_a[near], at_b[near]))) if near.any() else np.nan,
    )
    if not check.judged:
        return check
    uncorrected = explain(*pair, at_a, at_b, fine).sum()
    check = replace(check, precise=float(uncorrected / max(finely, 1)))
    counts = {
        advice: explain(*correct(*pair), at_a, at_b, fine).sum()
        for advice, correct in CORRECTIONS.items()
    }
    best = max(counts, key=counts.__getitem__)
    min_explained = max(MIN_GAIN * max(uncorrected, 1), MIN_CORRECTED * finely, MIN_AGREEING / 2)
    return replace(check, correction=best) if counts[best] >= min_explained else check


def explain(
    a: Camera, b: Camera, at_a: np.ndarray, at_b: np.ndarray, distance: float
) -> np.ndarray:
    """Find the matches [M, 2] and [M, 2] that two cameras explain: bool [M].

    A match is explained if its Sampson distance is below ``distance`` pixels and its point lies in
    front of both cameras.
    """
    relative = Relative.between(a, b)
    if not np.linalg.norm(relative.t) > 0:
        return np.zeros(len(at_a), bool)
    near = np.abs(relative.epipolar_distance(at_a, at_b)) < distance
    in_front_of_a = relative.triangulate(at_a, at_b) > 0
    return near & in_front_of_a & (relative.reverse().triangulate(at_b, at_a) > 0)


def agree(at_a: np.ndarray, at_b: np.ndarray, distance: float) -> np.ndarray:
    """Find the matches [M, 2] and [M, 2] that agree on some epipolar geometry: bool [M].

    They are the inliers, within ``distance`` pixels, of the fundamental matrix with most inliers
    (USAC, Raguram et al. 2013, fixed seed).
    """
    if len(at_a) < 8:
        return np.zeros(len(at_a), bool)
    try:
        _, inliers = cv2.findFundamentalMat(at_a, at_b, cv2.USAC_ACCURATE, distance, 0.999, 2000)
    except cv2.error:  # all points collinear, for instance
        inliers = None
    return np.zeros(len(at_a), bool) if inliers is None else inliers.ravel() > 0


def angles(a: Camera, b: Camera, at_a: np.ndarray, at_b: np.ndarray) -> np.ndarray:
    """Compute the angle [M], degrees, between the two rays of each match [M, 2] and [M, 2]."""
    rays = []
    for camera, pixels in ((a, at_a), (b, at_b)):
        local = np.concatenate([pixels, np.ones((len(pixels), 1))], 1) @ np.linalg.inv(camera.K).T
        world = local @ camera.c2w[:3, :3].T
        rays.append(world / np.linalg.norm(world, axis=1, keepdims=True))
    return np.degrees(np.arccos(np.clip((rays[0] * rays[1]).sum(1), -1, 1)))


def _refusal(check: PairCheck, estimated: bool) -> str:
    a, b = check.views
    explained = (
        f"{a!r} and {b!r}: the cameras {'that were found ' if estimated else ''}explain "
        f"{check.coarse:.0%} of the {check.matches} matches between the photographs to within "
        f"{check.pixels:.1f} pixels, though {check.agreeing / check.matches:.0%} agree with one "
        "another"
    )
    if estimated:
        return (
            f"{explained}, so they are wrong; take the photographs from places nearer to each "
            "other, or give their cameras with --cameras (--set trust_cameras=true goes on all the "
            "same)"
        )
    cause = "no usual mistake explains it; check that each photograph has its own pose and "
    cause += "intrinsics"
    if check.correction is not None:
        cause = f"they fit {check.correction}"
    return (
        f"{explained}; {cause} (`slgaussian field` without --cameras finds them from the "
        "photographs, --set trust_cameras=true goes on all the same)"
    )


_FLIP_YZ = np.diag([1.0, -1.0, -1.0, 1.0])


def _change_poses(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Camera, Camera], Pair]:
    return lambda a, b: (replace(a, c2w=change(a.c2w)), replace(b, c2w=change(b.c2w)))


def _scale(factor: float, columns: int) -> Callable[[Camera, Camera], Pair]:
    """Return a function that scales the first columns of K: 2 for focal lengths alone, or all 3."""
    scale = np.ones((3, 3))
    scale[:2, :columns] = factor
    return lambda a, b: (replace(a, K=scale * a.K), replace(b, K=scale * b.K))


def _factor_text(factor: float) -> str:
    return f"multiplied by {factor:.3g}" if factor > 1 else f"divided by {1 / factor:.3g}"


_INVERTED = "if every pose is inverted, in the axes of {}: world-to-camera for camera-to-world"

CORRECTIONS: dict[str, Callable[[Camera, Camera], Pair]] = {
    "if the two poses are exchanged: give each photograph its own": lambda a, b: (
        replace(a, c2w=b.c2w),
        replace(b, c2w=a.c2w),
    ),
    "if the y and z axes of every pose are reversed, OpenCV's for OpenGL's or the other way round: "
    "multiply the second and the third column of each by -1": _change_poses(
        lambda c2w: c2w @ _FLIP_YZ
    ),
    _INVERTED.format("OpenCV"): _change_poses(np.linalg.inv),
    _INVERTED.format("OpenGL"): _change_poses(lambda c2w: _FLIP_YZ @ np.linalg.inv(c2w) @ _FLIP_YZ),
    **{
        f"if the focal length is {_factor_text(factor)}": _scale(factor, 2)
        for factor in (1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 4, 4 / 3, 3 / 2, 2, 3, 4)
    },
    **{
        f"if focal length and principal point are {_factor_text(factor)}, as for a photograph of "
        "another size": _scale(factor, 3)
        for factor in (1 / 4, 1 / 2, 2, 4)
    },
}
"""Corrections of common mistakes, each tried alone, by the end of a sentence that begins with "they
fit"."""
