"""Liftings are judged by what novel views show, and told apart only beyond noise."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_lessons import lesson
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.errors import InputError
from slgaussian.semantic.branch import Architecture, Branch, BranchLifting
from slgaussian.semantic.corruption import KINDS
from slgaussian.semantic.hard import HardIndex
from slgaussian.semantic.judge import compare, label_iou

HARD = {"hard": HardIndex()}


def test_right_labels_of_a_wall_are_nearly_all_right():
    # Not wholly: Gaussians are 0.6 pixels wide, and an object is some ten. Measured 0.92.
    assert 0.9 < label_iou(lesson(), HARD)["hard"] <= 1


def test_an_untrained_branch_is_judged_as_the_control_is():
    both = {**HARD, "branch": BranchLifting(Branch(Architecture((4, 8), 8, False)))}
    scores = label_iou(lesson(), both)
    assert scores["branch"] == scores["hard"]
    assert label_iou(lesson(), both) == scores


def test_a_lost_object_counts_zero():
    mine = lesson()
    worse = mine.labels.copy()
    worse[worse == 4] = 0
    whole, less = (label_iou(mine, HARD, labels)["hard"] for labels in (None, worse))
    assert less == pytest.approx(whole * 3 / 4, abs=0.05)


@pytest.mark.parametrize("kind", KINDS)
def test_harm_is_seen(kind):
    mine = lesson()
    worse = mine.labels.copy()
    KINDS[kind](worse, 1, 4, np.random.default_rng(0))
    assert label_iou(mine, HARD, worse)["hard"] < label_iou(mine, HARD)["hard"] - 0.002


def test_what_the_target_leaves_open_and_what_no_context_names_does_not_count():
    mine = lesson()
    targets = mine.targets.copy()
    targets[targets == 4] = 0
    targets[:, :3, :3] = 9
    open_ = label_iou(replace(mine, targets=targets), HARD)["hard"]
    assert open_ > 0.9  # as without them, measured 0.93
    nothing = replace(mine, targets=np.zeros_like(targets))
    assert np.isnan(label_iou(nothing, HARD)["hard"])


@given(st.lists(st.floats(0, 1), min_size=1, max_size=30), st.floats(-0.5, 0.5))
def test_a_constant_gain_is_certain(scores, gain):
    found = compare([s + gain for s in scores], scores)
    assert found.difference == pytest.approx(gain, abs=1e-9)
    assert found.low == pytest.approx(gain, abs=1e-9)
    assert found.high == pytest.approx(gain, abs=1e-9)
    assert found.samples == len(scores)


def test_the_interval_is_that_of_the_mean():
    """For many samples 1.96 standard errors to both sides; 10,000 draws: measured 2 % off."""
    gains = np.random.default_rng(0).normal(0.03, 0.1, 400)
    found = compare(gains, np.zeros(400))
    error = gains.std() / 20
    assert found.low == pytest.approx(gains.mean() - 1.96 * error, abs=0.1 * error)
    assert found.high == pytest.approx(gains.mean() + 1.96 * error, abs=0.1 * error)
    assert compare(gains, np.zeros(400)) == found
    swapped = compare(np.zeros(400), gains)
    assert swapped.low == pytest.approx(-found.high)


def test_samples_without_a_score_are_left_out():
    found = compare([0.5, np.nan, 0.7], [0.4, 0.2, np.nan])
    assert found.samples == 1
    with pytest.raises(InputError, match="no sample that both were judged on"):
        compare([np.nan], [0.1])
    with pytest.raises(InputError, match="found 1 and 2 scores"):
        compare([0.1], [0.1, 0.2])
