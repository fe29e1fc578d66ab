"""What is on the Pareto front, against the definition."""

from hypothesis import given
from hypothesis import strategies as st

from slgaussian.benchmark.speed_error import front

STEPS = st.integers(0, 4)  # few, so that many are equal


@given(st.lists(st.tuples(STEPS | st.none(), STEPS), max_size=8))
def test_the_front_is_what_no_other_beats(points):
    costs, values = [p[0] for p in points], [p[1] for p in points]
    on = front(costs, values)
    for k, (cost, value) in enumerate(points):
        beaten = cost is None
        for other, worth in points:
            if cost is not None and other is not None:
                no_worse = other <= cost and worth >= value
                beaten |= no_worse and (other, worth) != (cost, value)
        assert on[k] == (not beaten)


@given(st.lists(st.tuples(STEPS, STEPS), min_size=1, max_size=8))
def test_the_best_and_the_cheapest_of_all_are_on_it(points):
    costs, values = zip(*points, strict=True)
    on = front(costs, values)
    cheapest = min(range(len(points)), key=lambda k: (costs[k], -values[k]))
    best = min(range(len(points)), key=lambda k: (-values[k], costs[k]))
    assert on[cheapest] and on[best]
