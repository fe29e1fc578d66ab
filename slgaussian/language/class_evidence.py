"""Evidence for ImageNet classes in regions, from log-probabilities quantised to bytes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

STEP = 1 / 12
"""Quantisation step of stored log-probabilities, nats."""


def quantised(log_probabilities: np.ndarray) -> np.ndarray:
    """Quantise log-probabilities to uint8: k stands for -k * :data:`STEP` nats."""
    return np.rint(np.clip(log_probabilities / -STEP, 0, 255)).astype(np.uint8)


def evidence(regions: np.ndarray, photographs: np.ndarray, classes: Sequence[int]) -> np.ndarray:
    """Compute the log-ratio of class probabilities in regions and in whole photographs.

    Args:
        regions: uint8 [..., V, 1000]. Scores of regions of V photographs, from :func:`quantised`.
        photographs: uint8 [V, 1000]. Mean scores of whole photographs.
        classes: sequence of int. The classes of a noun.

    Returns:
        float64 [..., V]: In nats.
    """
    lead: np.ndarray = log_probability(regions, classes) - log_probability(photographs, classes)
    return lead


def log_probability(stored: np.ndarray, classes: Sequence[int]) -> np.ndarray:
    """Compute the log-probability of any of the classes, float64 [...], from uint8 [..., 1000]."""
    total: np.ndarray = np.logaddexp.reduce(-STEP * stored[..., list(classes)], axis=-1)
    return total
