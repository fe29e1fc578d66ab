"""Scores of a relevancy image that need no threshold, and what each threshold would give.

A relevancy image is often one number an object, so that thousands of pixels tie. Pixels of one
value are taken all at once, never in some order: no score here depends on where a pixel lies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

BINS = 20
"""Bins of equal width over [0, 1] in which relevancy and truth are compared."""


@dataclass(frozen=True, eq=False)
class Ranking:
    """The pixels of an image by relevancy, best first, equal ones together.

    Attributes
    ----------
    values : float64 [K]
        The different relevancies, falling.
    found, true : int64 [K]
        Pixels with that relevancy or more, and those of them that are in the truth.
    """

    values: np.ndarray
    found: np.ndarray
    true: np.ndarray

    @property
    def positives(self) -> int:
        """Pixels of the truth."""
        return int(self.true[-1])

    @property
    def negatives(self) -> int:
        """Pixels outside the truth."""
        return int(self.found[-1] - self.true[-1])


def rank(relevancy: np.ndarray, truth: np.ndarray) -> Ranking:
    """Rank the pixels of a finite float [H, W] image against a bool [H, W] mask."""
    every, inside = np.sort(relevancy, axis=None), np.sort(relevancy[truth])
    first = np.flatnonzero(np.concatenate([[True], every[1:] != every[:-1]]))
    values = every[first]
    true = len(inside) - np.searchsorted(inside, values)
    return Ranking(values[::-1].astype(np.float64), (every.size - first)[::-1], true[::-1])


def average_precision(ranking: Ranking) -> float | None:
    """Precision at every different relevancy, weighted by the recall that it adds; in (0, 1].

    The step-wise sum, as scikit-learn has it, without interpolation. An image of one value scores
    the truth's fraction of the pixels. None if the truth is empty.
    """
    if not ranking.positives:
        return None
    gained = np.diff(ranking.true, prepend=0)
    return float((gained * (ranking.true / ranking.found)).sum() / ranking.positives)


def area_under_roc(ranking: Ranking) -> float | None:
    """Return how often a pixel of the truth is more relevant than one outside, ties counting half.

    In [0, 1]; an image of one value scores 0.5. None if the truth is empty, or everything.
    """
    if not ranking.positives or not ranking.negatives:
        return None
    false = ranking.found - ranking.true
    above = np.concatenate([[0], ranking.true[:-1]]) + ranking.true
    # Twice the number of pairs won is whole: exact below 2^63.
    twice = int((np.diff(false, prepend=0) * above).sum())
    return twice / (2 * ranking.positives * ranking.negatives)


def best_iou(ranking: Ranking) -> float:
    """The IoU with the best threshold for this one image: what no fixed threshold can exceed.

    The mask of at least one pixel is meant; 0 if the truth is empty.
    """
    return float((ranking.true / (ranking.found + ranking.positives - ranking.true)).max())


def ious_above(ranking: Ranking, thresholds: Sequence[float]) -> list[float]:
    """IoU of the pixels whose relevancy is above each threshold; 1 if neither has a pixel."""
    counts = np.searchsorted(-ranking.values, -np.asarray(thresholds, np.float64))
    predicted = np.concatenate([[0], ranking.found])[counts]
    true = np.concatenate([[0], ranking.true])[counts]
    union = predicted + ranking.positives - true
    return np.where(union > 0, true / np.maximum(union, 1), 1.0).tolist()


def calibration_error(ranking: Ranking) -> float:
    """Expected calibration error of relevancy as a chance that the pixel is in the truth; [0, 1].

    Of each of :data:`BINS` bins ((b - 1) / n, b / n], the first with 0, how far the mean
    relevancy is from the truth's fraction, averaged with the bins' pixels as weights (Naeini et al.
    2015; Guo et al. 2017, arXiv:1706.04599).
    """
    pixels = np.diff(ranking.found, prepend=0)
    hits = np.diff(ranking.true, prepend=0)
    gaps = np.bincount(bin_of(ranking.values), ranking.values * pixels - hits, BINS)
    return float(np.abs(gaps).sum() / ranking.found[-1])


def bin_of(chances: np.ndarray) -> np.ndarray:
    """The bin of each chance in [0, 1]: int64 [K]."""
    return np.searchsorted(np.arange(1, BINS) / BINS, chances)
