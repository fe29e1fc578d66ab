"""Every bound of a pair refuses or doubts by itself: each is moved, one at a time."""

import hard_photographs
import pytest

from slgaussian.cameras import two_view
from slgaussian.cameras.estimated import DOUBTFUL, GOOD, UNUSED
from slgaussian.cameras.two_view import Described, find_pair

CASES = [
    (UNUSED, {"MIN_INLIER_SHARE": 2.0}, "too few points are found"),
    (UNUSED, {"MIN_COVER": 1.1}, "one small part"),
    (UNUSED, {"REFUSED_UNCERTAINTY": 0.0}, "leave the position open by"),
    (UNUSED, {"REFUSED_PROBABILITY": 1.1}, "different positions of the cameras"),
    (UNUSED, {"REPETITION_LIMIT": -1.0}, "a pattern that repeats"),
    (UNUSED, {"MAX_HOMOGRAPHY_SHARE": -1.0, "DOUBTFUL_PROBABILITY": 1.1}, "different positions"),
    (DOUBTFUL, {"DOUBTFUL_UNCERTAINTY": 0.0}, "leave the position open by"),
    (DOUBTFUL, {"DOUBTFUL_PROBABILITY": 1.1}, "another position of the cameras"),
    (DOUBTFUL, {"ZOOM_RATIO": 0.5}, "times as large in one"),
    (DOUBTFUL, {"MIN_INLIERS": None}, "matches agree"),
]


@pytest.fixture(scope="module")
def described() -> list[Described]:
    return [Described.of(photograph) for photograph in hard_photographs.bikes()]


@pytest.fixture(scope="module")
def inliers(described) -> int:
    good = find_pair(*described).estimate
    assert good.verdict == GOOD
    return good.inliers


@pytest.mark.parametrize(("verdict", "bounds", "reason"), CASES)
def test_a_bound(verdict, bounds, reason, described, inliers, monkeypatch):
    for name, value in bounds.items():
        monkeypatch.setattr(two_view, name, inliers - 1 if value is None else value)
    pose = find_pair(*described)
    assert pose.estimate.verdict == verdict and reason in pose.estimate.said
    assert bool(pose.advice) == (verdict == UNUSED)
