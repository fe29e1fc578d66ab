"""Confidence intervals of means: the bootstrap (Efron 1979) over independent samples.

Percentile intervals, of resamplings that are the same for the same number of samples.
Where samples come in groups, such as pairs of views of one place, groups are drawn, and then
samples within each: both are a choice of what was measured.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from slgaussian.errors import InputError
from slgaussian.kernels.seeding import rng_for

DRAWS = 10_000
"""Resamplings of the bootstrap; of 10,000 the interval's ends have about two sure digits."""

LEVEL = 0.95
"""Fraction of the resamplings inside the interval."""

LEAST = 6
"""Samples below which no gain is beyond noise: of five, all gain by chance one time in 32, and the
level of the interval allows one in 40."""


@dataclass(frozen=True)
class Comparison:
    """By how much one thing is better than another on the same samples.

    Attributes
    ----------
    difference : float
        Mean over the samples of the score of the one minus that of the other.
    low, high : float
        Where the mean lies for :data:`LEVEL` of the resamplings: a gain is beyond noise if
        ``low`` is above 0.
    samples : int
    drawn : int
        Independent ones, that the resamplings draw first: those of one group count once.
    """

    difference: float
    low: float
    high: float
    samples: int
    drawn: int


def compare(
    scores: Sequence[float],
    baseline: Sequence[float],
    groups: Sequence[Hashable] | None = None,
) -> Comparison:
    """Paired bootstrap over samples: they are drawn with replacement, in pairs.

    Parameters
    ----------
    scores, baseline : sequence of float
        Of the two on the same samples, in one order. Samples without a score (NaN) are left out.
        Samples of one scene are no independent ones: without ``groups`` the interval is then too
        narrow.
    groups : sequence, optional
        What each sample is of, see :func:`drawn`.

    Raises
    ------
    InputError
        If the lengths differ or no sample has both scores.
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
    """Return where the mean of float [n], n > 0, lies for :data:`LEVEL` of the resamplings.

    With ``groups``, one a value, groups are drawn and then values within them, as :func:`drawn`
    says, and the mean is that of all values drawn, each of one weight. Of one value or group the
    interval says nothing of others: leave it out where it is printed.
    """
    if groups is None:
        return interval(values[resamplings(len(values))].mean(1))
    times = drawn(tuple(groups))
    return interval(np.einsum("dn,n->d", times, values) / times.sum(1))


def interval(statistics: np.ndarray) -> tuple[float, float]:
    """The middle :data:`LEVEL` of a statistic float [D] that was worked out on each resampling."""
    low, high = np.quantile(statistics, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)


@lru_cache(4)
def drawn(groups: tuple[Hashable, ...]) -> np.ndarray:
    """Count how often each resampling holds each sample: int32 [DRAWS, n], not to be changed.

    The hierarchical bootstrap (Davison and Hinkley 1997, section 3.8, with replacement twice): as
    many groups as there are, then of each, every time that it was drawn, as many of its samples as
    it has. ``groups`` are one a sample; with a group of its own for each it is the plain one.
    """
    members: dict[Hashable, list[int]] = {}
    for sample, group in enumerate(groups):
        members.setdefault(group, []).append(sample)
    chosen = resamplings(len(members))
    rng = rng_for(0, "", "bootstrap within groups")
    times = np.zeros((DRAWS, len(groups)), np.int32)
    for number, places in enumerate(members.values()):
        often = (chosen == number).sum(1)
        if len(places) == 1:
            times[:, places[0]] = often
        else:
            chances = np.full(len(places), 1 / len(places))
            times[:, places] = rng.multinomial(often * len(places), chances)
    times.flags.writeable = False
    return times


@lru_cache(4)
def resamplings(count: int) -> np.ndarray:
    """Draw the samples of each resampling: int32 [DRAWS, count] below ``count``, read-only."""
    drawn = rng_for(0, "", "bootstrap").integers(count, size=(DRAWS, count)).astype(np.int32)
    drawn.flags.writeable = False
    return drawn
