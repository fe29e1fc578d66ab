"""Errors of estimated relative poses."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

THRESHOLDS = (5.0, 10.0, 20.0)
WRONG = 20.0
"""Error in degrees above which a pose counts as wrong."""


def rotation_error(estimated: np.ndarray, true: np.ndarray) -> float:
    """Compute the angle between two rotations [3, 3], degrees."""
    # Poses in files are rounded, so project to the nearest rotation before taking the arc cosine.
    turn, _ = cv2.Rodrigues(estimated @ true.T)
    return float(np.degrees(np.linalg.norm(turn)))


def direction_error(estimated: np.ndarray, true: np.ndarray) -> float:
    """Compute the angle between two translations [3] of any lengths, degrees."""
    lengths = np.linalg.norm(estimated) * np.linalg.norm(true)
    cosine = estimated @ true / max(lengths, np.finfo(float).tiny)  # 90 degrees without a length
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def area_under_curve(
    errors: Sequence[float], thresholds: Sequence[float] = THRESHOLDS
) -> list[float]:
    """Compute the area under the recall curve of ``errors`` up to each threshold, in percent.

    It is the AUC of SuperGlue (Sarlin et al. 2020) and LightGlue. A pair without an answer counts
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
