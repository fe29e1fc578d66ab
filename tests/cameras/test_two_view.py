"""Every bound of a pair refuses or doubts by itself, and says so: each is moved, one at a time."""

import hard_photographs
import pytest

from slgaussian.cameras import two_view
from slgaussian.cameras.estimated import DOUBTFUL, GOOD, UNUSED
from slgaussian.cameras.two_view import Described, PairPose, find_pair

REFUSING = {
    "least share": ({"SHARE": 2.0}, "too few points are found"),
    "least spread": ({"SMALL": 1.1}, "one small part"),
    "open position": ({"BLUNT": 0.0}, "leave the position open by"),
    "other answers": ({"UNSURE": 1.1}, "different positions of the cameras"),
    "a pattern": ({"_repetition": lambda pose: 1.0}, "a pattern that repeats"),
    "other answers of a plane": ({"MOSTLY": -1.0, "SURE": 1.1}, "different positions"),
}
DOUBTING = {
    "open position": ({"SHARP": 0.0}, "leave the position open by"),
    "other answers": ({"SURE": 1.1}, "another position of the cameras"),
    "zoom": ({"ENLARGED": 0.5}, "times as large in one"),
}


@pytest.fixture(scope="module")
def described() -> list[Described]:
    return [
        Described.of(photograph) for photograph in hard_photographs.ANSWERED["the motorcycle"]()
    ]


@pytest.fixture(scope="module")
def plain(described) -> PairPose:
    return find_pair(*described)


@pytest.mark.parametrize("case", REFUSING)
def test_a_bound_refuses(case, described, monkeypatch):
    bounds, said = REFUSING[case]
    for name, value in bounds.items():
        monkeypatch.setattr(two_view, name, value)
    found = find_pair(*described)
    assert found.estimate.verdict == UNUSED and said in found.estimate.said and found.advice


@pytest.mark.parametrize("case", DOUBTING)
def test_a_bound_doubts(case, described, plain, monkeypatch):
    bounds, said = DOUBTING[case]
    for name, value in bounds.items():
        monkeypatch.setattr(two_view, name, value)
    found = find_pair(*described)
    assert plain.estimate.verdict == GOOD
    assert found.estimate.verdict == DOUBTFUL and said in found.estimate.said


def test_few_matches_are_doubted(described, plain, monkeypatch):
    monkeypatch.setattr(two_view, "LEAST", plain.estimate.inliers - 1)
    found = find_pair(*described).estimate
    assert found.verdict == DOUBTFUL and "matches agree" in found.said
