"""Keyframes: evenly along the way, and the sharpest of each part."""

import numpy as np
import pytest

from slgaussian.datasets.keyframes import choose_keyframes
from slgaussian.errors import InputError
from slgaussian.scene import Camera


def along(*places):
    cameras = []
    for x in places:
        c2w = np.eye(4)
        c2w[0, 3] = x
        cameras.append(Camera(np.diag([100.0, 100, 1]), c2w, 100, 80))
    return cameras


def test_the_sharpest_of_the_middle_of_each_part_is_taken():
    blurs = np.full(40, 0.5)
    blurs[[4, 6, 15, 23, 36]] = 0.1
    blurs[[0, 9, 30]] = 0.01  # sharper, but at the borders of parts
    assert choose_keyframes(blurs, 4) == [4, 15, 23, 36]


def test_standing_still_adds_no_keyframes():
    walk = along(*([0.0] * 30), *np.linspace(0.1, 1, 10))
    kept = choose_keyframes(np.zeros(40), 5, walk)
    assert len(kept) == 5 and sum(k < 30 for k in kept) <= 1


def test_keyframes_are_half_a_part_apart_at_least():
    rng = np.random.default_rng(0)
    for _ in range(20):
        kept = choose_keyframes(rng.random(100), 10)
        assert len(kept) == 10 and min(np.diff(kept)) >= 5


def test_few_frames_are_all_kept_and_one_keyframe_is_refused():
    assert choose_keyframes([0.3, 0.1, 0.2], 5) == [0, 1, 2]
    with pytest.raises(InputError, match="found 1, expected two or more"):
        choose_keyframes([0.3, 0.1], 1)
