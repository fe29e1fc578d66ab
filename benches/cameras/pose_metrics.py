"""How far found relative poses are from true ones."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

THRESHOLDS = (5.0, 10.0, 20.0)
WRONG = 20.0
"""Degrees above which an answer is of no use."""


def rotation_error(found: np.ndarray, true: np.ndarray) -> float:
    """Degrees between two rotations [3, 3]."""
    # By way of the nearest rotation: poses in files are rounded, and a cosine does not forgive it.
    turn, _ = cv2.Rodrigues(found @ true.T)
    return float(np.degrees(np.linalg.norm(turn)))


def direction_error(found: np.ndarray, true: np.ndarray) -> float:
    """Degrees between two translations [3] of any lengths."""
    cosine = found @ true / (np.linalg.norm(found) * np.linalg.norm(true) + 1e-12)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def area_under_curve(
    errors: Sequence[float], thresholds: Sequence[float] = THRESHOLDS
) -> list[float]:
    """Mean share, in hundredths, of ``errors`` below a bound, over all bounds up to each threshold.

    That is the AUC of SuperGlue (Sarlin et al. 2020) and LightGlue. A pair without an answer counts
    with an infinite error.
    """
    if not len(errors):
        return [float("nan")] * len(thresholds)
    e = np.concatenate([[0.0], np.sort(np.asarray(errors, float))])
    recall = np.arange(len(e)) / len(errors)
    out = []
    for threshold in thresholds:
        last = int(np.searchsorted(e, threshold))
        x = np.concatenate([e[:last], [threshold]])
        y = np.concatenate([recall[:last], [recall[last - 1]]])
        out.append(float(100 * np.trapezoid(y, x) / threshold))
    return out
