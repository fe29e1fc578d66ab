"""Liftings are judged by what novel views show."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_lessons import lesson

from slgaussian.semantic.branch import Architecture, BranchLifting, make_branch
from slgaussian.semantic.corruption import KINDS
from slgaussian.semantic.evaluation import label_iou
from slgaussian.semantic.hard import HardIndex

HARD = {"hard": HardIndex()}


def test_right_labels_of_a_wall_are_nearly_all_right():
    # Not wholly: Gaussians are 0.6 pixels wide, and an object is some ten. Measured 0.92.
    assert 0.9 < label_iou(lesson(), HARD)["hard"] <= 1


def test_an_untrained_branch_is_judged_as_the_control_is():
    branch = make_branch(Architecture(widths=(4, 8), hidden=8))
    both = {**HARD, "branch": BranchLifting(branch)}
    scores = label_iou(lesson(), both)
    assert scores["branch"] == scores["hard"]
    assert label_iou(lesson(), both) == scores


def test_a_lost_object_counts_zero():
    mine = lesson()
    worse = mine.labels.copy()
    worse[worse == 4] = 0
    whole, less = (label_iou(mine, HARD, labels)["hard"] for labels in (None, worse))
    assert less == pytest.approx(whole * 3 / 4, abs=0.05)


def test_what_the_target_leaves_open_and_what_no_context_names_does_not_count():
    mine = lesson()
    targets = mine.targets.copy()
    targets[targets == 4] = 0
    targets[:, :3, :3] = 9
    targets[:, :, ::2] = 0  # half of every object: what is shown there says nothing about it
    assert label_iou(replace(mine, targets=targets), HARD)["hard"] > 0.9  # measured 0.93
    nothing = replace(mine, targets=np.zeros_like(targets))
    assert np.isnan(label_iou(nothing, HARD)["hard"])


@pytest.mark.parametrize("kind", KINDS)
def test_harm_is_seen(kind):
    mine = lesson()
    worse = mine.labels.copy()
    KINDS[kind](worse, 1, 4, np.random.default_rng(0))
    assert label_iou(mine, HARD, worse)["hard"] < label_iou(mine, HARD)["hard"] - 0.002
