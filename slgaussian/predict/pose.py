"""A given relative pose, refined for dense matching by sparse matches."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from slgaussian.cameras.relative import Relative

MIN_REFINE = 30
"""Fewest matches near their epipolar lines that a refinement of the pose is based on."""

GATE = 0.02
"""Distance to the epipolar line, as a share of the image diagonal, beyond which the given pose
rules a match out: 0.02 forgives about one degree of rotation at common focal lengths."""

PRIOR_ROTATION = np.radians(0.3)
PRIOR_DIRECTION = np.radians(5.0)
"""Standard deviations of a given relative pose that the refinement assumes. The direction of a
short baseline is the least certain part of it."""


def refine(given: Relative, ref: np.ndarray, src: np.ndarray) -> Relative:
    """Adjust rotation and direction of translation so that matches meet their epipolar lines.

    Robust least squares of the Sampson distance with the given pose as a prior; the length of the
    baseline is kept, and with fewer than :data:`MIN_REFINE` matches so is the pose. Serves
    to tell good matches; where poses are off, :mod:`slgaussian.predict.pose_refinement` moves all
    cameras.
    """
    if len(ref) < MIN_REFINE:
        return given
    length = np.linalg.norm(given.t)
    direction = given.t / length
    # Two axes across the direction of translation.
    across = np.linalg.svd(direction[None])[2][1:]

    def moved(step: np.ndarray) -> Relative:
        turned = direction + step[3:] @ across
        R = cv2.Rodrigues(step[:3])[0] @ given.R
        return replace(given, R=R, t=turned * (length / np.linalg.norm(turned)))

    deviation = np.repeat([PRIOR_ROTATION, PRIOR_DIRECTION], [3, 2])

    def residuals(step: np.ndarray) -> np.ndarray:
        return np.concatenate([moved(step).epipolar_distance(ref, src), step / deviation])

    from scipy.optimize import least_squares  # only here, and it takes long to import

    fit = least_squares(residuals, np.zeros(5), loss="cauchy", f_scale=0.5, x_scale=deviation)
    return moved(fit.x)
