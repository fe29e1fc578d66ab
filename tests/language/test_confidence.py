"""Confidence rises with the best gap and with how far an answer stands out, and says what it is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.language.confidence import (
    ABSENT,
    EVEN_OUT,
    TYPICAL,
    Calibration,
    Confidence,
    Curve,
    confidence,
    signs,
)
from slgaussian.language.lexicon import Lexicon

CALIBRATION = Lexicon.calibration
gap = st.floats(-0.5, 0.5)


def test_signs_are_the_best_gap_and_deviations_above_the_rest():
    gaps = np.array([0.3, 0.2, 0.02, 0.0, -0.02])
    taken = np.array([True, True, False, False, False])
    deviation = np.sqrt(2 * 0.02**2 / 3)
    best, stands_out = signs(gaps, taken)
    assert best == 0.3
    assert stands_out == pytest.approx(0.25 / (deviation + EVEN_OUT))


def test_without_an_answer_the_best_one_is_looked_at():
    gaps = np.array([-0.3, -0.1, -0.3, -0.3])
    best, stands_out = signs(gaps, np.zeros(4, bool))
    assert best == -0.1
    assert stands_out == pytest.approx(0.2 / EVEN_OUT)


@pytest.mark.parametrize("count", [1, 2])
def test_with_nothing_to_compare_with_it_stands_out_as_most_do(count):
    assert signs(np.linspace(0.1, 0.0, count), np.arange(count) == 0)[1] == TYPICAL


@given(gap, gap, st.floats(-5, 5))
def test_a_curve_rises_with_the_gap_and_is_a_probability(one, other, out):
    curve = CALIBRATION.mask
    low, high = sorted((one, other))
    assert 0 < curve(low, out) <= curve(high, out) < 1


@given(st.lists(gap, min_size=3, max_size=12), st.floats(0.01, 0.5))
def test_what_leads_by_more_is_surer(rest, lead):
    """The same rest, and one answer that is better."""

    def sure(best: float) -> Confidence:
        gaps = np.array([best, *rest])
        return confidence(CALIBRATION, gaps, gaps == best)

    least = max(rest) + 0.01
    assert sure(least).mask <= sure(least + lead).mask
    assert sure(least).point <= sure(least + lead).point


def test_extremes_are_no_overflow():
    assert 0 < Curve(1e6, 0, 0)(-1, 0) < 1e-9
    assert Curve(1e6, 0, 0)(1, 0) <= 1


@pytest.mark.parametrize(
    ("mask", "point", "verdict"),
    [
        (0.9, 0.95, "found"),
        (0.5, ABSENT, "found"),
        (0.49, 0.9, "not sure"),
        (0.9, ABSENT - 1e-6, "not here"),
    ],
)
def test_the_verdict(mask, point, verdict):
    assert Confidence(mask, point).verdict == verdict


def test_each_curve_gives_its_own_probability():
    calibration = Calibration(Curve(0, 0, 1), Curve(0, 0, -1))
    sure = confidence(calibration, np.array([0.1, 0.0, 0.0]), np.array([True, False, False]))
    assert sure.mask == pytest.approx(1 / (1 + np.exp(-1)))
    assert sure.point == pytest.approx(1 / (1 + np.exp(1)))
