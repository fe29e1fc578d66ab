import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from slgaussian.masks.associate import vote


def plain_vote(stack):
    """The rule, written as loops over pixels and replicas."""
    labels = np.zeros(stack.shape[1:], np.int32)
    margin = np.zeros(stack.shape[1:])
    for pixel in np.ndindex(labels.shape):
        ballots = [int(replica[pixel]) for replica in stack]
        counts = {label: ballots.count(label) for label in ballots}
        winner = max(ballots, key=lambda label: counts[label])  # max keeps the first of equals
        won = counts.pop(winner)
        labels[pixel] = winner
        margin[pixel] = (won - max(counts.values(), default=0)) / len(ballots)
    return labels, margin


stacks = hnp.arrays(
    np.int32,
    st.tuples(st.integers(1, 7), st.integers(1, 3), st.integers(1, 4)),
    elements=st.integers(0, 4),
)


@given(stacks)
def test_vote_equals_plain_majority(stack):
    labels, margin = vote(stack)
    expected_labels, expected_margin = plain_vote(stack)
    np.testing.assert_array_equal(labels, expected_labels)
    np.testing.assert_allclose(margin, expected_margin, atol=1e-7)  # one float32 rounding of [0, 1]
    assert labels.dtype == np.int32 and margin.dtype == np.float32


@given(stacks, st.lists(st.integers(1, 4), min_size=7, max_size=7))
def test_map_with_weight_counts_as_many_equal_maps(stack, times):
    times = times[: len(stack)]
    labels, margin = vote(stack, times)
    expected, won = vote(np.repeat(stack, times, 0))
    np.testing.assert_array_equal(labels, expected)
    np.testing.assert_array_equal(margin, won)
