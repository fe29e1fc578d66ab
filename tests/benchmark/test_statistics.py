"""Bootstrap intervals: differences count only beyond noise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.benchmark.statistics import compare, interval_of_mean, resample_counts
from slgaussian.errors import InputError


@given(st.lists(st.floats(0, 1), min_size=1, max_size=30), st.floats(-0.5, 0.5))
def test_compare_has_no_width_for_a_constant_gain(scores, gain):
    actual = compare([s + gain for s in scores], scores)
    assert (actual.difference, actual.low, actual.high) == (pytest.approx(gain, abs=1e-9),) * 3
    assert actual.samples == len(scores)


def test_compare_omits_samples_without_a_score():
    assert compare([0.5, np.nan, 0.7], [0.4, 0.2, np.nan]).samples == 1
    with pytest.raises(InputError, match="no sample that both were judged on"):
        compare([np.nan], [0.1])
    with pytest.raises(InputError, match="found 1 and 2 scores"):
        compare([0.1], [0.1, 0.2])


def plainly(groups: list, values: np.ndarray, draws: int) -> list[float]:
    """Resample groups, then values within each group, in plain loops; return the means."""
    rng = np.random.default_rng(7)
    members = [values[np.array(groups) == name] for name in dict.fromkeys(groups)]
    means = []
    for _ in range(draws):
        drawn = (members[k] for k in rng.integers(len(members), size=len(members)))
        means.append(
            float(np.mean(np.concatenate([rng.choice(group, len(group)) for group in drawn])))
        )
    return means


def test_resample_counts_draw_groups_then_samples():
    """Comparison with plain loops that use other random numbers.

    The large group is the best, so the mean of group means differs from the mean of all values; its
    values differ, so drawing whole groups would give another interval.
    """
    groups = list("babccbadefgggggg")
    values = np.random.default_rng(2).random(len(groups))
    values[-6:] = (1, 1, 1, 1, 1, 12)
    means = plainly(groups, values, 6000)
    times = resample_counts(tuple(groups))
    weighted = times @ values / times.sum(1)
    ends = tuple(np.quantile(weighted, [0.025, 0.975]))
    assert interval_of_mean(values, groups=groups) == pytest.approx(ends)
    # Of 6000 draws the deviation is within 1 % of its own, and so are the ends and the mean.
    assert weighted.std() == pytest.approx(np.std(means), rel=0.04)
    expected = [np.mean(means), *np.quantile(means, [0.025, 0.975])]
    assert [weighted.mean(), *ends] == pytest.approx(expected, abs=0.1 * weighted.std())


@given(st.lists(st.floats(0, 1), min_size=2, max_size=20), st.integers(2, 5))
def test_compare_is_not_narrower_with_repeated_samples(values, copies):
    once = compare(values, [0.0] * len(values))
    groups = np.repeat(range(len(values)), copies).tolist()
    repeated = compare(np.repeat(values, copies), [0.0] * len(groups), groups)
    assert (repeated.low, repeated.high) == pytest.approx((once.low, once.high), abs=1e-12)
    assert (repeated.samples, repeated.independent_samples) == (copies * len(values), len(values))
