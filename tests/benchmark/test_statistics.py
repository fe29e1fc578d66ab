"""Things are told apart only beyond noise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.benchmark.statistics import (
    compare,
    interval_of_mean,
    resample_counts,
    resamplings,
)
from slgaussian.errors import InputError


@given(st.lists(st.floats(0, 1), min_size=1, max_size=30), st.floats(-0.5, 0.5))
def test_a_constant_gain_is_certain(scores, gain):
    found = compare([s + gain for s in scores], scores)
    assert found.difference == pytest.approx(gain, abs=1e-9)
    assert found.low == pytest.approx(gain, abs=1e-9)
    assert found.high == pytest.approx(gain, abs=1e-9)
    assert found.samples == len(scores)


def test_samples_without_a_score_are_left_out():
    found = compare([0.5, np.nan, 0.7], [0.4, 0.2, np.nan])
    assert found.samples == 1
    with pytest.raises(InputError, match="no sample that both were judged on"):
        compare([np.nan], [0.1])
    with pytest.raises(InputError, match="found 1 and 2 scores"):
        compare([0.1], [0.1, 0.2])


def plainly(groups: list, values: np.ndarray, draws: int) -> list[float]:
    """The means of some resamplings by loops: groups, then as many values in each as it has."""
    rng = np.random.default_rng(7)
    own = {name: [v for g, v in zip(groups, values, strict=True) if g == name] for name in groups}
    names, means = list(own), []
    for _ in range(draws):
        taken: list[float] = []
        for k in rng.integers(len(names), size=len(names)):
            inside = own[names[k]]
            taken += [inside[j] for j in rng.integers(len(inside), size=len(inside))]
        means.append(float(np.mean(taken)))
    return means


def test_groups_are_drawn_and_then_values_within_them():
    """Against plain loops with random numbers of their own.

    The large group is the best, so means of groups would be another score than that of all values;
    and its values differ, so groups drawn whole would have another interval.
    """
    groups = list("babccbadefgggggg")
    values = np.random.default_rng(2).random(len(groups))
    values[-6:] = (1, 1, 1, 1, 1, 12)
    means = plainly(groups, values, 6000)
    times = resample_counts(tuple(groups))
    own = times @ values / times.sum(1)
    assert interval_of_mean(values, groups=groups) == pytest.approx(
        tuple(np.quantile(own, [0.025, 0.975]))
    )
    # Of 6000 draws the deviation is within 1 % of its own, and so are the ends and the mean.
    assert own.std() == pytest.approx(np.std(means), rel=0.04)
    wanted = [np.mean(means), *np.quantile(means, [0.025, 0.975])]
    found = [own.mean(), *np.quantile(own, [0.025, 0.975])]
    assert found == pytest.approx(wanted, abs=0.1 * own.std())
    names = list(dict.fromkeys(groups))
    by_name = {name: values[np.array(groups) == name] for name in names}
    whole = [
        np.concatenate([by_name[names[k]] for k in chosen]).mean()
        for chosen in resamplings(len(names)).tolist()
    ]
    assert own.std() > 1.2 * np.std(whole)
    assert own.mean() > 1.2 * np.mean([mean.mean() for mean in by_name.values()])


@given(st.lists(st.floats(0, 1), min_size=2, max_size=20), st.integers(2, 5))
def test_samples_that_are_there_several_times_make_nothing_surer(values, copies):
    once = compare(values, [0.0] * len(values))
    groups = [k for k in range(len(values)) for _ in range(copies)]
    again = compare([v for v in values for _ in range(copies)], [0.0] * len(groups), groups)
    assert (again.low, again.high) == pytest.approx((once.low, once.high), abs=1e-12)
    assert (again.samples, again.independent_samples) == (copies * len(values), len(values))
