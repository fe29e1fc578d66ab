"""Lower bounds on the quality of the method.

``python -m benches.scores.score_floors 3 DATA`` printed the numbers that are said to be measured,
of three draws of the ID codes; nothing else is random. A floor leaves some room for a processor
that rounds otherwise.
"""

from pathlib import Path

import pytest

from benches.scores import score_floors

pytestmark = pytest.mark.whole


@pytest.fixture(scope="module")
def rooms():
    return score_floors.rooms(seed=0)


def test_words_are_found_in_made_up_rooms(rooms):
    """Measured: 0.565 to 0.572."""
    assert rooms["iou"] > 0.54


def test_novel_views_of_made_up_rooms_are_as_sharp(rooms):
    """Measured: 27.23 dB."""
    assert rooms["psnr"] > 27.1


def test_depth_of_the_motorcycle_pair():
    """Measured: bad-2.0 6.25 %, mean relative error 1.74 %.

    OpenCV's semi-global matcher has 17.9 % bad pixels.
    """
    scores = score_floors.motorcycle(seed=0)
    assert scores["bad2"] < 0.068
    assert scores["abs_rel"] < 0.0187


def having(folder: Path, name: str) -> Path:
    """The folder of real data, if it has the set of that name."""
    if not (folder / name).is_dir():
        pytest.skip(f"SLG_TEST_DATA has no folder {name}")
    return folder


def test_words_are_found_in_photographs_of_the_office(real_data):
    """Measured on four of its eight pairs, at a quarter of the pixels: 0.405 to 0.407."""
    assert score_floors.office(having(real_data, "office"), seed=0)["iou"] > 0.37


def test_words_are_found_in_photographs_of_other_places(real_data):
    """Measured on three of them, at a quarter of the pixels: 0.343 to 0.344."""
    assert score_floors.places(having(real_data, "places"), seed=0)["iou"] > 0.31
