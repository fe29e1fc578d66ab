"""Evidence for classes of ImageNet in regions, from log-probabilities that are stored as bytes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

STEP = 1 / 12
"""Nats a step of stored log-probabilities, which are uint8."""


def quantised(log_probabilities: np.ndarray) -> np.ndarray:
    """Log-probabilities as they are stored: uint8, :data:`STEP` nats below 0 each."""
    return np.rint(np.clip(log_probabilities / -STEP, 0, 255)).astype(np.uint8)


def evidence(regions: np.ndarray, photographs: np.ndarray, classes: Sequence[int]) -> np.ndarray:
    """Compute how much more likely some classes are in regions than in whole photographs.

    Parameters
    ----------
    regions : uint8 [..., V, 1000]
        Of V photographs, as :func:`quantised`.
    photographs : uint8 [V, 1000]
        Means of whole photographs.
    classes : sequence of int
        Those that a noun means.

    Returns
    -------
    float64 [..., V]
        Log of the ratio, in nats.
    """
    lead: np.ndarray = log_probability(regions, classes) - log_probability(photographs, classes)
    return lead


def log_probability(stored: np.ndarray, classes: Sequence[int]) -> np.ndarray:
    """Log of the probability of any of some classes, float64 [...], of uint8 [..., 1000]."""
    total: np.ndarray = np.logaddexp.reduce(-STEP * stored[..., list(classes)], axis=-1)
    return total
