"""Relative pose by OpenCV alone, the baseline of the pose benches."""

from __future__ import annotations

import cv2
import numpy as np

from slgaussian.cameras.matches import find_features, match

FEATURES = 4000
CONTRAST = 0.02
RATIO = 0.85
PIXELS = 1.0


def matches(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return mutual RootSIFT matches of two RGB images: float64 [M, 2], pixel centres at +0.5."""
    features = [
        find_features(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), FEATURES, CONTRAST)
        for image in (a, b)
    ]
    at_a, at_b, _ = match(*features, RATIO)
    return features[0].points[at_a], features[1].points[at_b]


def relative_pose(
    at_a: np.ndarray, at_b: np.ndarray, K_a: np.ndarray, K_b: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Estimate ``X_b = R @ X_a + t`` from matches [M, 2] and [M, 2]; None without a solution."""
    if len(at_a) < 8:
        return None
    rays = [cv2.undistortPoints(at[:, None], K, None) for at, K in ((at_a, K_a), (at_b, K_b))]
    focal = (K_a[0, 0] + K_a[1, 1] + K_b[0, 0] + K_b[1, 1]) / 4
    E, inliers = cv2.findEssentialMat(
        *rays, np.eye(3), method=cv2.USAC_ACCURATE, prob=0.999, threshold=PIXELS / focal
    )
    if E is None or E.shape != (3, 3):
        return None
    _, R, t, _ = cv2.recoverPose(E, *rays, np.eye(3), mask=inliers)
    return R, t[:, 0]


def guess_intrinsics(width: int, height: int, factor: float = 1.2) -> np.ndarray:
    """Return intrinsics with COLMAP's default focal length."""
    focal = factor * max(width, height)
    return np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
