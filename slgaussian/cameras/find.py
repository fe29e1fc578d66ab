"""Estimate cameras from photographs alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from slgaussian.cameras.estimated import DOUBTFUL, UNUSED, EstimatedCameras, Focal
from slgaussian.cameras.multi_view import PlacedCameras, Solve, Unplaced, find_multi_view
from slgaussian.cameras.two_view import (
    EXIF_SPREAD,
    SPREAD,
    Described,
    Photograph,
    confidence,
    find_pair,
)
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
    left = {}
    for photograph in photographs:
        same = (earlier for earlier in once if np.array_equal(earlier.image, photograph.image))
        if (first := next(same, None)) is None:
            once.append(photograph)
        else:
            left[photograph.name] = f"it is the same picture as {first.name}"
    if len(once) < 2:
        once, left = list(photographs), {}
    described = [Described.of(photograph) for photograph in once]
    solve = cache(find_pair)
    remaining = described
    while True:
        try:
            solution = (
                find_multi_view(remaining, solve)
                if len(remaining) > 2
                else _find_two(remaining[0], remaining[1], solve)
            )
            break
        except Unplaced as gap:
            remaining = [item for item in remaining if item.photograph.name not in gap.left_out]
            if 2 * len(remaining) <= len(described):
                raise
            left |= gap.left_out
    left = {p.name: left[p.name] for p in photographs if p.name in left}
    warnings = tuple(f"{name} is left out: {why}" for name, why in left.items())
    return replace(_estimated_cameras(solution, remaining), warnings=warnings, left_out=left)


def _find_two(a: Described, b: Described, solve: Solve) -> PlacedCameras:
    first, second = sorted((a, b), key=lambda item: item.digest)
    pose = solve(first, second)
    views = pose.views
    if pose.estimate.verdict == UNUSED or views is None or views.covariance is None:
        raise InputError(
            f"{a.photograph.name!r} and {b.photograph.name!r}: no cameras can be found: "
            f"{pose.estimate.said}; {pose.advice}"
        )
    R, t, focals = views.R, views.t, views.focals
    moves = np.sqrt(np.diag(views.covariance)[5:])
    deviations = np.array([first.focal[1], second.focal[1]]) * (moves if len(moves) else 0)
    if first is not a:
        R, t = R.T, -R.T @ t
        focals, deviations = focals[::-1], deviations[::-1]
    return PlacedCameras(
        np.stack([np.eye(3), R]),
        np.stack([np.zeros(3), t]),
        focals,
        deviations,
        (replace(pose.estimate, views=(a.photograph.name, b.photograph.name)),),
        confidence(pose) * (DOUBTED if pose.estimate.verdict == DOUBTFUL else 1),
    )


def _estimated_cameras(solution: PlacedCameras, described: Sequence[Described]) -> EstimatedCameras:
    doubt = ""
    if len(solution.pairs) > 1 and solution.confidence < SURE:
        doubt = "some photographs share little with the others"
    elif len(solution.pairs) == 1 and solution.pairs[0].verdict == DOUBTFUL:
        doubt = solution.pairs[0].said
    cameras, focals = {}, {}
    for k, item in enumerate(described):
        photograph = item.photograph
        pixels = solution.focals[k] / item.shrunk
        focal = focal_of(pixels, float(solution.deviations[k]), photograph)
        c2w = np.eye(4)
        c2w[:3, :3], c2w[:3, 3] = solution.R[k].T, -solution.R[k].T @ solution.t[k]
        focals[photograph.name] = focal
        cameras[photograph.name] = camera_of(photograph, focal, c2w, solution.confidence)
    return EstimatedCameras(cameras, focals, solution.pairs, solution.confidence, doubt)


def focal_of(pixels: float, deviation: float, photograph: Photograph) -> Focal:
    """Return the focal length of the whole photograph with its interval, from the standard
    deviation of its logarithm."""
    by_exif = photograph.focal is not None
    deviation = float(np.hypot(OPTIMISM * deviation, MODEL))
    deviation = min(deviation, EXIF_SPREAD if by_exif else SPREAD)
    wide = float(np.exp(Z_90 * deviation))
    source = "EXIF" if by_exif else "matches" if deviation < NARROWED * SPREAD else "guess"
    return Focal(float(pixels), float(pixels / wide), float(pixels * wide), source)


def camera_of(photograph: Photograph, focal: Focal, c2w: np.ndarray, sure: float) -> Camera:
    """Return the camera of a whole photograph, with the principal point in the centre."""
    f, width, height = focal.pixels, photograph.width, photograph.height
    K = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]])
    estimated = Estimated((focal.low / f, focal.high / f), focal.source, sure)
    return Camera(K, c2w, width, height, estimated=estimated)
