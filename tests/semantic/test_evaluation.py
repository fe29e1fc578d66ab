"""Liftings are judged by what novel views show."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_lessons import lesson

from slgaussian.semantic.branch import Architecture, BranchLifting, make_branch
from slgaussian.semantic.evaluation import label_iou
from slgaussian.semantic.hard import HardIndex

HARD = {"hard": HardIndex()}


def test_right_labels_of_a_wall_are_nearly_all_right():
    # Not wholly: Gaussians are 0.6 pixels wide, and an object is some ten. Measured 0.92.
    both = {**HARD, "branch": BranchLifting(make_branch(Architecture(widths=(4, 8), hidden=8)))}
    scores = label_iou(lesson(), both)
    assert 0.9 < scores["hard"] <= 1
    assert scores["branch"] < scores["hard"] and label_iou(lesson(), both) == scores


def test_a_lifting_that_loses_an_object_scores_zero_for_it():
    def lossy(gaussians, label_maps, bank):
        labels = np.where(label_maps.labels == 4, 0, label_maps.labels)
        return HardIndex()(gaussians, replace(label_maps, labels=labels), bank)

    scores = label_iou(lesson(), {**HARD, "lossy": lossy})
    assert scores["lossy"] == pytest.approx(scores["hard"] * 3 / 4, abs=0.05)


def test_what_the_target_leaves_open_and_what_no_context_names_does_not_count():
    mine = lesson()
    targets = mine.targets.copy()
    targets[targets == 4] = 0
    targets[:, :3, :3] = 9
    targets[:, :, ::2] = 0  # half of every object: what is shown there says nothing about it
    assert label_iou(replace(mine, targets=targets), HARD)["hard"] > 0.9  # measured 0.93
    nothing = replace(mine, targets=np.zeros_like(targets))
    assert np.isnan(label_iou(nothing, HARD)["hard"])
