"""Confidence rises with evidence and contrast to other objects, and falls with parts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.language.answer import (
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
small = st.floats(-0.1, 0.1)


APART = np.sqrt(2 * 0.02**2 / 3) + STD_OFFSET  # deviation of 0.02, 0, -0.02


@pytest.mark.parametrize(
    ("gaps", "selected", "measurements", "parts", "expected"),
    [
        ([0.3, 0.2, 0.02, 0, -0.02], 2, 4, 2, Signs(4 * 0.3, 0.25 / APART, np.log(2))),
        # An answer of nearly all objects stands out less.
        ([0.2] * 90 + [0.02, 0, -0.02], 90, 4, 1, Signs(0.8, 0.2 / APART * 4 / 90, 0)),
        ([0.2] * 3 + [0.02, 0, -0.02], 3, 4, 1, Signs(0.8, 0.2 / APART, 0)),
        # Without an answer the best one is looked at.
        ([-0.1, -0.3, -0.3, -0.3], 0, 3, 0, Signs(-0.3, 0.2 / STD_OFFSET, 0)),
        # With nothing to compare with it stands out as most do.
        ([0.1], 1, 1, 1, Signs(0.1, TYPICAL_STAND_OUT, 0)),
        ([0.1, 0], 1, 1, 1, Signs(0.1, TYPICAL_STAND_OUT, 0)),
    ],
)
def test_signs_measure_evidence_contrast_and_parts(gaps, selected, measurements, parts, expected):
    chosen = np.arange(len(gaps)) < selected
    assert signs(np.array(gaps), chosen, measurements, parts) == pytest.approx(expected)


@given(small, small, st.floats(-5, 5), st.integers(1, 20), st.integers(1, 30), st.integers(0, 30))
def test_curves_rise_with_evidence_and_fall_with_parts(one, other, out, measurements, parts, more):
    low, high = (gap * measurements for gap in sorted((one, other)))
    for curve in (CALIBRATION.mask, CALIBRATION.point):
        log_parts, log_more_parts = np.log(parts), np.log(parts + more)
        assert 0 < curve(Signs(low, out, log_parts)) <= curve(Signs(high, out, log_parts)) < 1
        assert curve(Signs(low, out, log_more_parts)) <= curve(Signs(low, out, log_parts))


def test_understand_counts_the_measurements_of_a_text():
    lexicon = Lexicon()
    alone = lexicon.understand("chair").measurements
    measurements = np.count_nonzero(lexicon.encode_text(["chair"])[0][:-1])
    assert alone == measurements > 1
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
def test_verdict_follows_mask_and_point_probability(mask, point, verdict):
    assert Confidence(mask, point).verdict == verdict


def test_calibration_gives_a_probability_per_curve():
    """By hand: 2 * 0.1 + 0.5 * 2 - 0.3 * 1 + 0.4 * 3 - 1 is 1.1."""
    calibration = Calibration(Curve(2, 0.5, -0.3, 0.4, -1), Curve(0, 0, 0, 0, -1))
    sure = calibration(Signs(0.1, 2, 1, 3))
    assert sure.mask == pytest.approx(1 / (1 + np.exp(-1.1)))
    assert sure.point == pytest.approx(1 / (1 + np.exp(1)))
