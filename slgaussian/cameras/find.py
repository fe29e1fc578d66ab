"""Estimate cameras from photographs alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from slgaussian.cameras.estimated import DOUBTFUL, UNUSED, EstimatedCameras, EstimatedPair, Focal
from slgaussian.cameras.multi_view import PairSolver, PlacedCameras, Unplaced, find_multi_view
from slgaussian.cameras.two_view import EXIF_SPREAD, SPREAD, Described, Photograph, confidence
from slgaussian.errors import InputError
from slgaussian.scene import Camera, Estimated

Z_90 = 1.645
"""Standard deviations on either side of the mean that contain 90 % of a normal distribution."""

OPTIMISM, MODEL = 2.0, 0.04
"""The loss underestimates errors of matches, and no lens is a true pinhole: the deviation of a log
focal length is multiplied by ``OPTIMISM``, and ``MODEL`` is added in quadrature. Chosen so that
about 90 % of the true focal lengths of the pairs and chains of `docs/measured/poses.md` lie in
the interval."""

SURE = 0.8
"""Confidence below which cameras of three or more photographs are reported as doubtful."""

DOUBTED = 0.85
"""Factor of the confidence in a pair whose cameras are doubtful: of 28 doubtful pairs, 20
photographed and 8 rendered with two focal lengths (``docs/measured/poses.md``), 4 were wrong."""

MENTIONED = 3
"""Largest number of photographs left out for which a warning gives the reason."""

NARROWED = 0.8
"""The source of a focal length is "matches" if its deviation is below this fraction of the prior's.
"""


def find_cameras(photographs: Sequence[Photograph]) -> EstimatedCameras:
    """Estimate the cameras of two or more photographs.

    The same photographs give the same cameras; their order determines only the world frame.
    Photographs that cannot be placed are left out if they are the minority. Duplicates are left out
    if at least two different photographs remain.

    Raises:
        InputError: If the estimation fails; the message names the photographs, the reason and what
            to do.
    """
    once: list[Photograph] = []
    duplicates = {}
    for photograph in photographs:
        same = (earlier for earlier in once if np.array_equal(earlier.image, photograph.image))
        first = next(same, None)
        if first is None:
            once.append(photograph)
        else:
            duplicates[photograph.name] = f"it is the same picture as {first.name}"
    if not duplicates or len(once) < 2:
        return _find(photographs)
    estimate = _find(once)
    sentences = (f"{name} is left out: {why}" for name, why in duplicates.items())
    warnings = (*estimate.warnings, *sentences)
    return replace(estimate, warnings=warnings, left_out={**estimate.left_out, **duplicates})


def _find(photographs: Sequence[Photograph]) -> EstimatedCameras:
    """Implement :func:`find_cameras` for photographs without duplicates."""
    described = [Described.of(photograph) for photograph in photographs]
    remaining, left = described, dict[str, str]()
    solver = PairSolver()
    while True:
        try:
            solution = (
                find_multi_view(remaining, solver)
                if len(remaining) > 2
                else _find_two(remaining[0], remaining[1], solver)
            )
            break
        except Unplaced as gap:
            if 2 * (len(left) + len(gap.left_out)) >= len(described):
                raise
            left |= gap.left_out
            remaining = [item for item in remaining if item.photograph.name not in left]
        except InputError as refusal:
            if not left:
                raise
            raise InputError(f"{_left_out(left, len(described))}; and then {refusal}") from None
    left = {p.name: left[p.name] for p in photographs if p.name in left}
    estimate = _estimated_cameras(solution, remaining)
    if not left:
        return estimate
    aside = tuple(_left_out_pairs(solver, described, left))
    warnings = (*estimate.warnings, _left_out(left, len(described)))
    return replace(estimate, pairs=estimate.pairs + aside, warnings=warnings, left_out=left)


def _left_out(left: Mapping[str, str], count: int) -> str:
    """Return a sentence that names the photographs left out, the reasons and what to do."""
    reasons = [f"{name!r} ({why})" for name, why in list(left.items())[:MENTIONED]]
    rest = f", and {len(left) - MENTIONED} more" if len(left) > MENTIONED else ""
    return (
        f"{len(left)} of {count} photographs cannot be placed among the others, and "
        f"{'is' if len(left) == 1 else 'are'} left out: {', '.join(reasons)}{rest}; take "
        "photographs between them and the others that overlap both by half or more"
    )


def _left_out_pairs(
    solver: PairSolver, described: Sequence[Described], left: Mapping[str, str]
) -> list[EstimatedPair]:
    """List the pairs that contain a photograph that was left out, with verdict UNUSED."""
    place = {entry.photograph.name: k for k, entry in enumerate(described)}
    pairs = []
    for pose in solver.poses.values():
        views = sorted(pose.estimate.views, key=place.__getitem__)
        if left.keys() & {*views}:
            reason = pose.estimate.said or "of a photograph that cannot be placed among the others"
            entry = replace(pose.estimate, views=(views[0], views[1]), verdict=UNUSED, said=reason)
            pairs.append(entry)
    return pairs


def _find_two(a: Described, b: Described, solver: PairSolver) -> PlacedCameras:
    first, second = sorted((a, b), key=lambda item: item.digest)
    pose = solver(first, second)
    views = pose.views
    if pose.estimate.verdict == UNUSED or views is None or views.covariance is None:
        raise InputError(
            f"{a.photograph.name!r} and {b.photograph.name!r}: no cameras can be found: "
            f"{pose.estimate.said}; {pose.advice}"
        )
    moves = np.sqrt(np.diag(views.covariance)[5:])
    R, t = views.R, views.t
    focals = views.focals
    deviations = np.array([first.focal[1], second.focal[1]]) * (moves if len(moves) else 0)
    if first is not a:
        R, t = R.T, -R.T @ t
        focals, deviations = focals[::-1], deviations[::-1]
    return PlacedCameras(
        np.stack([np.eye(3), R]),
        np.stack([np.zeros(3), t]),
        focals,
        deviations,
        np.zeros(2),
        (replace(pose.estimate, views=(a.photograph.name, b.photograph.name)),),
        confidence(pose) * (DOUBTED if pose.estimate.verdict == DOUBTFUL else 1),
    )


def _estimated_cameras(solution: PlacedCameras, described: Sequence[Described]) -> EstimatedCameras:
    photographs = [item.photograph for item in described]
    if len(solution.pairs) == 1:
        (pair,) = solution.pairs
        doubt = pair.said if pair.verdict == DOUBTFUL else ""
    else:
        doubt = (
            "some photographs share little with the others" if solution.confidence < SURE else ""
        )
    cameras, focals = {}, {}
    for k, (item, photograph) in enumerate(zip(described, photographs, strict=True)):
        focal = focal_of(
            solution.focals[k] / item.shrunk, float(solution.deviations[k]), photograph
        )
        c2w = np.eye(4)
        c2w[:3, :3], c2w[:3, 3] = solution.R[k].T, -solution.R[k].T @ solution.t[k]
        focals[photograph.name] = focal
        cameras[photograph.name] = camera_of(photograph, focal, c2w, solution.confidence)
    return EstimatedCameras(
        cameras,
        focals,
        {p.name: float(k1) for p, k1 in zip(photographs, solution.k1, strict=True)},
        solution.pairs,
        solution.confidence,
        doubt,
    )


def focal_of(pixels: float, deviation: float, photograph: Photograph) -> Focal:
    """Return the focal length of the whole photograph with its interval, from the standard
    deviation of its logarithm."""
    prior = EXIF_SPREAD if photograph.focal is not None else SPREAD
    deviation = min(float(np.hypot(OPTIMISM * deviation, MODEL)), prior)
    wide = float(np.exp(Z_90 * deviation))
    if photograph.focal is not None:
        source = "EXIF"
    else:
        source = "matches" if deviation < NARROWED * SPREAD else "guess"
    return Focal(float(pixels), float(pixels / wide), float(pixels * wide), source)


def camera_of(photograph: Photograph, focal: Focal, c2w: np.ndarray, sure: float) -> Camera:
    """Return the camera of a whole photograph, with the principal point in the centre."""
    f, width, height = focal.pixels, photograph.width, photograph.height
    K = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]])
    estimated = Estimated((focal.low / f, focal.high / f), focal.source, sure)
    return Camera(K, c2w, width, height, estimated=estimated)
