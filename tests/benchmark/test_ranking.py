"""Scores without thresholds, against plain loops, above all where pixels tie."""

import numpy as np
import plain
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from slgaussian.benchmark import ranking

SHAPE = (5, 8)
TIED = arrays(np.float32, SHAPE, elements=st.sampled_from([0.0, 0.05, 0.25, 0.5, 0.55, 0.9, 1.0]))
ANY = arrays(np.float64, SHAPE, elements=st.floats(0, 1))
MASKS = arrays(bool, SHAPE)


@given(st.one_of(TIED, ANY), MASKS)
def test_scores_are_those_of_plain_loops(relevancy, truth):
    found = ranking.rank(relevancy, truth)
    assert (found.positives, found.negatives) == (truth.sum(), (~truth).sum())
    if truth.any():
        expected = plain.average_precision(relevancy, truth)
        assert ranking.average_precision(found) == pytest.approx(expected, abs=1e-12)
        best = max(plain.iou(mask, truth) for mask in plain.cuts(relevancy))
        assert ranking.best_iou(found) == pytest.approx(best, abs=1e-12)
    if truth.any() and not truth.all():
        expected = plain.auc(relevancy, truth)
        assert ranking.area_under_roc(found) == pytest.approx(expected, abs=1e-12)
    thresholds = [0.0, 0.05, 0.5, 0.55, 0.9, 1.0]
    expected = [plain.iou(relevancy.astype(np.float64) > t, truth) for t in thresholds]
    assert ranking.ious_above(found, thresholds) == expected
    error = plain.calibration_error(relevancy, truth)
    assert ranking.calibration_error(found) == pytest.approx(error, abs=1e-12)


@given(TIED, MASKS)
def test_auc_is_the_share_of_pairs_in_order(relevancy, truth):
    inside, outside = relevancy[truth], relevancy[~truth]
    found = ranking.area_under_roc(ranking.rank(relevancy, truth))
    if not len(inside) or not len(outside):
        assert found is None
        return
    won = (inside[:, None] > outside).mean() + (inside[:, None] == outside).mean() / 2
    assert found == pytest.approx(won, abs=1e-12)
    flipped = ranking.area_under_roc(ranking.rank(1 - relevancy, truth))
    assert found + flipped == pytest.approx(1, abs=1e-12)


def test_empty_and_full_truths_have_what_is_defined():
    relevancy = np.linspace(0, 1, 40, dtype=np.float32).reshape(SHAPE)
    none = ranking.rank(relevancy, np.zeros(SHAPE, bool))
    assert ranking.average_precision(none) is ranking.area_under_roc(none) is None
    assert ranking.best_iou(none) == 0.0
    assert ranking.ious_above(none, [0.5, 1.0]) == [0.0, 1.0]
    everything = ranking.rank(relevancy, np.ones(SHAPE, bool))
    assert ranking.average_precision(everything) == 1.0
    assert ranking.area_under_roc(everything) is None
