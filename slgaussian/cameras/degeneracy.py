"""Degenerate pairs of photographs, which match but determine no depth: no baseline, or a plane.

Two photographs taken from one place, or two of one plane, are related by a homography. If almost
all matches fit a homography, the camera positions are undetermined, whatever an estimator returns.
"""

from __future__ import annotations

import cv2
import numpy as np

from slgaussian.cameras.epipolar import FocalPrior

FLAT = 0.92
"""Ratio of homography inliers to essential-matrix inliers from which on a pair is degenerate."""

NEAR = 2.0
"""Largest distance of an inlier of the homography, pixels."""

STILL = 1.5
"""Largest median distance, pixels, at which identity, crop or rotation explains the matches."""

FOCALS = np.linspace(-3.4, 3.6, 15)
"""Focal lengths with which a pure rotation is tried, in standard deviations of their prior."""


def why_no_depth(
    x: np.ndarray, y: np.ndarray, prior: FocalPrior, explained: int
) -> tuple[np.ndarray, tuple[str, str] | None]:
    """Find the homography inliers, bool [M], and the reason if the pair is degenerate.

    Matches are [M, 2] and [M, 2], pixels from the principal points; ``explained`` is the number of
    inliers of the relative pose. The reason is a pair of clauses: cause and advice; else None.
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
    """Compute the median distance, pixels, of ``y`` from ``x`` after the best scale and shift."""
    off = []
    for k in (0, 1):
        A = np.stack([x[:, k], np.ones(len(x))], 1)
        solution = np.linalg.lstsq(A, y[:, k], rcond=None)[0]
        off.append(y[:, k] - A @ solution)
    return float(np.median(np.hypot(*off)))


def _off_turn(x: np.ndarray, y: np.ndarray, prior: FocalPrior) -> float:
    """Compute the median distance, pixels, of ``y`` from ``x`` after the best rotation."""
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
