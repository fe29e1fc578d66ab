"""The quality of the whole method has a floor, within what chance moves it by.

Means and standard deviations are those that ``python -m benches.scores.score_floors 10 DATA``
printed, of ten draws (nine of photographs), when the scene's name was part of the seed. A floor is
the mean less some four deviations of one draw, so that another seed, or a processor that rounds
otherwise, stays above it, and what costs more than that falls below: of the planes that fill the
motorcycle's depth all but one left out, or the smoothness of the matching a fifth.
"""

from pathlib import Path

import pytest

from benches.scores import score_floors


@pytest.fixture(scope="module")
def rooms():
    return score_floors.rooms(seed=0)


def test_words_are_found_in_made_up_rooms(rooms):
    """Measured: 0.615 +- 0.009, which is the noise of one seed."""
    assert rooms["iou"] > 0.57


def test_novel_views_of_made_up_rooms_are_as_sharp(rooms):
    """Measured: 27.33 +- 0.02 dB; of another processor some more is allowed for."""
    assert rooms["psnr"] > 27.2


def test_depth_of_the_motorcycle_pair():
    """Measured: bad-2.0 6.18 +- 0.14 %, mean relative error 1.79 +- 0.02 %.

    OpenCV's semi-global matcher has 17.9 % bad pixels.
    """
    found = score_floors.motorcycle(seed=0)
    assert found["bad2"] < 0.068
    assert found["abs_rel"] < 0.0187


def having(folder: Path, name: str) -> Path:
    """The folder of real data, if it has the set of that name."""
    if not (folder / name).is_dir():
        pytest.skip(f"SLG_TEST_DATA has no folder {name}")
    return folder


def test_words_are_found_in_photographs_of_the_office(real_data):
    """Measured on four of its eight pairs, at a quarter of the pixels: 0.354 +- 0.011."""
    assert score_floors.office(having(real_data, "office"), seed=0)["iou"] > 0.31


def test_words_are_found_in_photographs_of_other_places(real_data):
    """Measured on three of them, at a quarter of the pixels: 0.276 +- 0.011."""
    assert score_floors.places(having(real_data, "places"), seed=0)["iou"] > 0.23
