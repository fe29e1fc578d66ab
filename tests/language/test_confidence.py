"""Confidence rises with evidence and standing out, falls with parts, and says what it is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.language.confidence import (
    MIN_POINT_PROBABILITY,
    STD_OFFSET,
    TYPICAL_STAND_OUT,
    Calibration,
    Confidence,
    Curve,
    Signs,
    signs,
)
from slgaussian.language.lexicon import Lexicon

CALIBRATION = Lexicon.calibration
gap = st.floats(-0.5, 0.5)
small = st.floats(-0.1, 0.1)


def test_signs_are_evidence_deviations_above_the_rest_and_parts():
    gaps = np.array([0.3, 0.2, 0.02, 0.0, -0.02])
    taken = np.array([True, True, False, False, False])
    deviation = np.sqrt(2 * 0.02**2 / 3)
    at = signs(gaps, taken, 4, 2)
    assert at.evidence == pytest.approx(4 * 0.3)
    assert at.stands_out == pytest.approx(0.25 / (deviation + STD_OFFSET))
    assert at.parts == pytest.approx(np.log(2))


def test_an_answer_of_nearly_all_objects_stands_out_less():
    gaps, taken = np.append(np.full(90, 0.2), [0.02, 0.0, -0.02]), np.arange(93) < 90
    deviation = np.sqrt(2 * 0.02**2 / 3)
    whole = signs(gaps, taken, 4, 1).stands_out
    assert whole == pytest.approx(0.2 / (deviation + STD_OFFSET) * 4 / 90)
    few = signs(gaps[87:], taken[87:], 4, 1).stands_out  # 3 of 6: no less
    assert few == pytest.approx(0.2 / (deviation + STD_OFFSET))


def test_without_an_answer_the_best_one_is_looked_at():
    gaps = np.array([-0.3, -0.1, -0.3, -0.3])
    at = signs(gaps, np.zeros(4, bool), 3, 0)
    assert at.evidence == pytest.approx(-0.3)
    assert at.stands_out == pytest.approx(0.2 / STD_OFFSET)
    assert at.parts == 0


@pytest.mark.parametrize("count", [1, 2])
def test_with_nothing_to_compare_with_it_stands_out_as_most_do(count):
    at = signs(np.linspace(0.1, 0.0, count), np.arange(count) == 0, 1, 1)
    assert at.stands_out == TYPICAL_STAND_OUT


@given(small, small, st.floats(-5, 5), st.integers(1, 20), st.integers(1, 30), st.integers(0, 30))
def test_curves_rise_with_the_gap_fall_with_the_parts_and_are_probabilities(
    one, other, out, measurements, parts, more
):
    low, high = (gap * measurements for gap in sorted((one, other)))
    for curve in (CALIBRATION.mask, CALIBRATION.point):
        few, many = np.log(parts), np.log(parts + more)
        assert 0 < curve(Signs(low, out, few)) <= curve(Signs(high, out, few)) < 1
        assert curve(Signs(low, out, many)) <= curve(Signs(low, out, few))


def test_the_lexicon_counts_what_a_text_asks_for():
    lexicon = Lexicon()
    alone = lexicon.understand("chair").measurements
    asked = np.count_nonzero(lexicon.encode_text(["chair"])[0][:-1])
    assert alone == asked > 1
    assert lexicon.understand("red chair").measurements == alone + 1
    assert lexicon.understand("the red chairs").measurements == alone + 1


@pytest.mark.parametrize(
    ("mask", "point", "verdict"),
    [
        (0.9, 0.95, "found"),
        (0.5, MIN_POINT_PROBABILITY, "found"),
        (0.49, 0.9, "not sure"),
        (0.9, MIN_POINT_PROBABILITY - 1e-6, "not here"),
    ],
)
def test_the_verdict(mask, point, verdict):
    assert Confidence(mask, point).verdict == verdict


def test_each_curve_gives_its_own_probability():
    """By hand: 2 * 0.1 + 0.5 * 2 - 0.3 * 1 + 0.4 * 3 - 1 is 1.1."""
    calibration = Calibration(Curve(2, 0.5, -0.3, 0.4, -1), Curve(0, 0, 0, 0, -1))
    sure = calibration(Signs(0.1, 2, 1, 3))
    assert sure.mask == pytest.approx(1 / (1 + np.exp(-1.1)))
    assert sure.point == pytest.approx(1 / (1 + np.exp(1)))
