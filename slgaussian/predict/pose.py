"""Refinement of a given relative pose by sparse matches."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from slgaussian.cameras.relative import Relative

MIN_REFINE = 30
"""Smallest number of matches near their epipolar lines for a refinement of the pose."""

GATE = 0.02
"""Distance to the epipolar line, as a share of the image diagonal, beyond which a match is an
outlier under the given pose: 0.02 allows about one degree of rotation at common focal lengths."""

PRIOR_ROTATION = np.radians(0.3)
PRIOR_DIRECTION = np.radians(5.0)
"""Assumed standard deviations of a given relative pose. The direction of a short baseline is its
least certain part."""


def refine(prior: Relative, ref: np.ndarray, src: np.ndarray) -> Relative:
    """Refine rotation and translation direction by the Sampson distance of matches.

    Robust least squares with the given pose as a prior. The baseline length does not change; with
    fewer than :data:`MIN_REFINE` matches neither does the pose. The result serves to select
    inliers; :mod:`slgaussian.predict.pose_refinement` corrects inaccurate cameras.

    Args:
        prior: The given pose.
        ref, src: float64 [M, 2]. Matched pixels of the reference and the source.
    """
    if len(ref) < MIN_REFINE:
        return prior
    length = np.linalg.norm(prior.t)
    direction = prior.t / length
    # Two axes orthogonal to the direction of translation.
    across = np.linalg.svd(direction[None])[2][1:]

    def moved(step: np.ndarray) -> Relative:
        turned = direction + step[3:] @ across
        R = cv2.Rodrigues(step[:3])[0] @ prior.R
        return replace(prior, R=R, t=turned * (length / np.linalg.norm(turned)))

    deviation = np.repeat([PRIOR_ROTATION, PRIOR_DIRECTION], [3, 2])

    def residuals(step: np.ndarray) -> np.ndarray:
        return np.concatenate([moved(step).epipolar_distance(ref, src), step / deviation])

    from scipy.optimize import least_squares  # slow to import, and needed only here

    fit = least_squares(residuals, np.zeros(5), loss="cauchy", f_scale=0.5, x_scale=deviation)
    return moved(fit.x)
