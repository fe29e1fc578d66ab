"""Confidence intervals of means: the percentile bootstrap (Efron 1979) over independent samples.

If samples form groups, such as pairs of views of one place, groups are resampled, and then samples
within each group. The resamplings are the same for the same number of samples.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from slgaussian.errors import InputError
from slgaussian.kernels.seeding import rng_for

RESAMPLINGS = 10_000
"""Number of resamplings; with 10,000 the interval's ends have about two reliable digits."""

BLOCK = 100
"""Number of resamplings drawn at once."""

CONFIDENCE_LEVEL = 0.95
"""Fraction of the resamplings inside the interval."""

MIN_SAMPLES = 6
"""Smallest number of samples for a significant gain: with five samples all differences are positive
by chance with probability 1/32, more than the 1/40 per tail that a 95 % interval allows."""


@dataclass(frozen=True)
class Comparison:
    """Mean difference of two methods on the same samples, with its interval.

    Attributes:
        difference: Mean over the samples of the score minus the baseline.
        low, high: Interval at level :data:`CONFIDENCE_LEVEL`: a gain is significant if ``low`` is
            above 0.
        independent_samples: Number of independent groups (or samples), which are resampled first.
    """

    difference: float
    low: float
    high: float
    samples: int
    independent_samples: int


def compare(
    scores: Sequence[float],
    baseline: Sequence[float],
    groups: Sequence[Hashable] | None = None,
) -> Comparison:
    """Compare two methods by the paired bootstrap over samples.

    Args:
        scores, baseline: Scores on the same samples, in one order; those with NaN are left out.
        groups: Group of each sample, see :func:`resample_counts`. Without it the interval is too
            narrow if samples are not independent, such as those of one scene.

    Raises:
        InputError: If the lengths differ or no sample has both scores.
    """
    if len(scores) != len(baseline):
        raise InputError(f"compare: found {len(scores)} and {len(baseline)} scores, expected pairs")
    gains = np.asarray(scores, np.float64) - np.asarray(baseline, np.float64)
    finite = np.isfinite(gains)
    if not finite.any():
        raise InputError("compare: found no sample that both were judged on, expected at least one")
    of = range(len(gains)) if groups is None else groups
    of = [group for group, counts in zip(of, finite, strict=True) if counts]
    gains = gains[finite]
    ends = interval_of_mean(gains, of)
    return Comparison(float(gains.mean()), *ends, len(gains), len(set(of)))


def interval_of_mean(
    values: np.ndarray, groups: Sequence[Hashable] | None = None
) -> tuple[float, float]:
    """Return the bootstrap interval of the mean of float [n], n > 0 (:data:`CONFIDENCE_LEVEL`).

    With ``groups``, one per value, see :func:`resample_counts`; all drawn values have equal weight.
    With a single value or group the interval is meaningless.
    """
    if groups is None:
        return interval(values[resamplings(len(values))].mean(1))
    numbers = dict[Hashable, int]()
    times = resample_counts(tuple(numbers.setdefault(group, len(numbers)) for group in groups))
    return interval(np.einsum("dn,n->d", times, values) / times.sum(1))


def interval(statistics: np.ndarray) -> tuple[float, float]:
    """Return the interval of a statistic float [D] of resamplings (:data:`CONFIDENCE_LEVEL`)."""
    low, high = np.quantile(statistics, [(1 - CONFIDENCE_LEVEL) / 2, (1 + CONFIDENCE_LEVEL) / 2])
    return float(low), float(high)


@lru_cache(2)
def resample_counts(groups: tuple[int, ...]) -> np.ndarray:
    """Count how often each resampling contains each sample: uint16 [RESAMPLINGS, n], read-only.

    This is the hierarchical bootstrap (Davison and Hinkley 1997, section 3.8, with replacement at
    both levels): draw as many groups as there are, then for each draw of a group as many of its
    samples as it has. ``groups`` has the number of the group of each sample.
    """
    members: dict[int, list[int]] = {}
    for sample, group in enumerate(groups):
        members.setdefault(group, []).append(sample)
    drawn = (row for block in _draw(len(members)) for row in block)
    counts = [np.bincount(row, minlength=len(members)).astype(np.uint16) for row in drawn]
    rng = rng_for(0, "", "bootstrap within groups")
    times = np.zeros((RESAMPLINGS, len(groups)), np.uint16)
    for often, places in zip(np.transpose(counts), members.values(), strict=True):
        if len(places) == 1:
            times[:, places[0]] = often
        else:
            chances = np.full(len(places), 1 / len(places))
            times[:, places] = rng.multinomial(often.astype(np.int64) * len(places), chances)
    times.flags.writeable = False
    return times


@lru_cache(2)
def resamplings(count: int) -> np.ndarray:
    """Draw the sample indices of each resampling: int32 [RESAMPLINGS, count], read-only."""
    drawn = np.concatenate([*_draw(count)], dtype=np.int32)
    drawn.flags.writeable = False
    return drawn


def _draw(count: int) -> Iterator[np.ndarray]:
    """Draw sample indices, int64 [RESAMPLINGS, count], in blocks of :data:`BLOCK` resamplings."""
    rng = rng_for(0, "", "bootstrap")
    for _ in range(RESAMPLINGS // BLOCK):
        yield rng.integers(count, size=(BLOCK, count))
