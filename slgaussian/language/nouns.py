"""Nouns: which of the 1,000 classes of ImageNet a word means, by the tree of WordNet.

The table is made by ``benches/language/noun_table.py`` from WordNet 3.0, Copyright 2006 by
Princeton University, all rights reserved; ``noun_classes.LICENSE`` beside it is its licence.
"""

from __future__ import annotations

import lzma
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files

import numpy as np

STEP = 1 / 12
"""Nats a step of stored log-probabilities, which are uint8."""

TABLE = "noun_classes.txt.xz"
"""A line for each set of classes: their numbers, a tab, and the words that mean it."""


@cache
def noun_classes() -> Mapping[str, tuple[int, ...]]:
    """The classes of every noun of the table, of one to three words in lower case."""
    table: dict[str, tuple[int, ...]] = {}
    content = files(__package__).joinpath(TABLE).read_bytes()
    for line in lzma.decompress(content).decode().splitlines():
        numbers, words = line.split("\t")
        table |= dict.fromkeys(words.split(","), tuple(map(int, numbers.split())))
    return table


def quantised(log_probabilities: np.ndarray) -> np.ndarray:
    """Log-probabilities as they are stored: uint8, :data:`STEP` nats below 0 each."""
    return np.rint(np.clip(log_probabilities / -STEP, 0, 255)).astype(np.uint8)


def evidence(regions: np.ndarray, photographs: np.ndarray, classes: Sequence[int]) -> np.ndarray:
    """How much more likely some classes are in regions than in the whole photographs.

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
