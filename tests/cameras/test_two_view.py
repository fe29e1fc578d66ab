"""Bounds on a pair of photographs: each one, moved alone, causes its own refusal or doubt."""

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
def good_pair() -> tuple[list[Described], int]:
    """Return a pair of the verdict ``GOOD``, and the number of its inliers."""
    described = [Described.of(photograph) for photograph in hard_photographs.motorcycle_pair()]
    good = find_pair(*described).estimate
    assert good.verdict == GOOD
    return described, good.inliers


@pytest.mark.parametrize(("verdict", "bounds", "reason"), CASES)
def test_moved_bound_causes_its_verdict(verdict, bounds, reason, good_pair, monkeypatch):
    described, inliers = good_pair
    for name, value in bounds.items():
        monkeypatch.setattr(two_view, name, inliers - 1 if value is None else value)
    pose = find_pair(*described)
    assert pose.estimate.verdict == verdict and reason in pose.estimate.reason
    assert bool(pose.advice) == (verdict == UNUSED)
