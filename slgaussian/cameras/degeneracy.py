"""Photographs that no depth can be found from, though they match: no step between them, or a plane.

Two photographs taken from one place, and two of one flat thing, are related by a homography. If
almost all matches obey one, positions are open, whatever an estimator makes of them: it is said
which of the usual reasons it is.
"""

from __future__ import annotations

import cv2
import numpy as np

from slgaussian.cameras.epipolar import FocalPrior

FLAT = 0.92
"""Matches on the homography, as a share of those that an essential matrix explains, from which on
there is hardly anything else."""

NEAR = 2.0
"""Pixels up to which a match obeys a homography."""

STILL = 1.5
"""Pixels, median, up to which matches have not moved, or have as a crop or a turn moves them."""

FOCALS = np.linspace(-3.4, 3.6, 15)
"""Focal lengths that a turn is tried with, deviations of what is known of them."""


def why_no_depth(
    x: np.ndarray, y: np.ndarray, prior: FocalPrior, explained: int
) -> tuple[np.ndarray, tuple[str, str] | None]:
    """Find the matches [M, 2] and [M, 2], pixels from the middles, of one homography, bool [M].

    And the reason why they hold no depth and what to do, two clauses; None if they hold some, of
    which ``explained`` fit one relative pose.
    """
    try:
        H, inliers = cv2.findHomography(x, y, cv2.USAC_ACCURATE, NEAR, None, 2000, 0.999)
    except cv2.error:
        return np.zeros(len(x), bool), None
    on = np.zeros(len(x), bool) if H is None else inliers.ravel() > 0
    if on.sum() < FLAT * explained:
        return on, None
    x, y = x[on], y[on]
    aside = "take the second photograph from a step sideways"
    if np.median(np.linalg.norm(x - y, axis=1)) < STILL:
        return on, ("they show the same picture, if with another exposure", aside)
    if _off_crop(x, y) < STILL:
        return on, ("one is a crop, or a zoom from the same place, of the other", aside)
    if _off_turn(x, y, prior) < STILL:
        return on, ("the camera turned but hardly moved between them", aside)
    return on, (
        "nearly all that both show is one flat thing, a plane",
        "take photographs with things at different distances in both",
    )


def _off_crop(x: np.ndarray, y: np.ndarray) -> float:
    """Median distance, pixels, of ``y`` from the best ``x`` scaled and shifted along the axes."""
    off = []
    for k in (0, 1):
        A = np.stack([x[:, k], np.ones(len(x))], 1)
        solution = np.linalg.lstsq(A, y[:, k], rcond=None)[0]
        off.append(y[:, k] - A @ solution)
    return float(np.median(np.hypot(*off)))


def _off_turn(x: np.ndarray, y: np.ndarray, prior: FocalPrior) -> float:
    """Median distance, pixels, of ``y`` from ``x`` under the best rotation and focal lengths."""
    smallest = np.inf
    for moves in FOCALS if len(prior.directions) else np.zeros(1):
        fa, fb = np.exp(prior.mean + np.full(len(prior.directions), moves) @ prior.directions)
        a = np.concatenate([x / fa, np.ones((len(x), 1))], 1)
        b = np.concatenate([y / fb, np.ones((len(y), 1))], 1)
        a, b = (rays / np.linalg.norm(rays, axis=1, keepdims=True) for rays in (a, b))
        U, _, V = np.linalg.svd(b.T @ a)  # Kabsch
        R = U @ np.diag([1, 1, np.linalg.det(U @ V)]) @ V
        turned = a @ R.T
        smallest = min(
            smallest,
            float(np.median(np.linalg.norm(fb * turned[:, :2] / turned[:, 2:] - y, axis=1))),
        )
    return smallest
