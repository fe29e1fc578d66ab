"""IoU of liftings in novel views."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_lessons import lesson

from slgaussian.semantic.branch import Architecture, BranchLifting, make_branch
from slgaussian.semantic.evaluation import label_iou
from slgaussian.semantic.hard import HardIndex

HARD = {"hard": HardIndex()}


def test_label_iou_is_near_one_for_true_labels():
    # Below 1, since Gaussians are 0.6 pixels wide and objects some ten. Measured 0.92.
    liftings = {**HARD, "branch": BranchLifting(make_branch(Architecture(widths=(4, 8), hidden=8)))}
    scores = label_iou(lesson(), liftings)
    assert 0.9 < scores["hard"] <= 1
    assert scores["branch"] < scores["hard"] and label_iou(lesson(), liftings) == scores


def test_label_iou_of_a_missing_object_is_zero():
    def lossy(gaussians, label_maps, bank):
        labels = np.where(label_maps.labels == 4, 0, label_maps.labels)
        return HardIndex()(gaussians, replace(label_maps, labels=labels), bank)

    scores = label_iou(lesson(), {**HARD, "lossy": lossy})
    assert scores["lossy"] == pytest.approx(scores["hard"] * 3 / 4, abs=0.05)


def test_label_iou_ignores_unlabelled_pixels():
    example = lesson()
    targets = example.targets.copy()
    targets[targets == 4] = 0
    targets[:, :3, :3] = 9
    targets[:, :, ::2] = 0  # half of every object: renderings there are not judged
    assert label_iou(replace(example, targets=targets), HARD)["hard"] > 0.9  # measured 0.93
    unlabelled = replace(example, targets=np.zeros_like(targets))
    assert np.isnan(label_iou(unlabelled, HARD)["hard"])
