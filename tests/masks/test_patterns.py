import numpy as np
import pytest
from drawn_views import SIZE, canvas, paste, view

from slgaussian.geometry import SeenView
from slgaussian.masks.segmentation import join_patterns

FLOOR, RED, WHITE, BLUE = (150, 140, 90), (200, 40, 40), (235, 235, 235), (40, 60, 190)


def draw(*things):
    """A picture and its true pieces, int32 from 0: boxes of one colour each on a floor."""
    picture, pieces = canvas(FLOOR, contrast=2), np.zeros(SIZE, np.int32)
    for number, (box, colour) in enumerate(things, start=1):
        paste(picture, box, colour)
        pieces[box[0] : box[1], box[2] : box[3]] = number
    return view(picture).image, pieces


def checks(rows, columns, colors, top=20, left=30, side=12):
    return [
        (
            (top + side * r, top + side * (r + 1), left + side * c, left + side * (c + 1)),
            colors[(r + c) % 2],
        )
        for r in range(rows)
        for c in range(columns)
    ]


def groups(image, pieces, depth=None):
    """The joined region of every piece, in the order of the pieces."""
    joined = join_patterns(SeenView.alone(image).view.lab, pieces, depth)
    used = np.unique(joined[joined >= 0])
    assert used.tolist() == list(range(len(used)))
    of = [np.unique(joined[pieces == piece]) for piece in range(pieces.max() + 1)]
    assert all(len(labels) == 1 for labels in of)  # no piece is ever split
    return [int(labels[0]) for labels in of]


@pytest.mark.parametrize("size", [(4, 5), (1, 6), (6, 1), (2, 3)])
def test_checks_and_stripes_are_joined_without_the_floor(size):
    floor, *pattern = groups(*draw(*checks(*size, (RED, WHITE))))
    assert len(set(pattern)) == 1 and floor not in pattern


@pytest.mark.parametrize("size", [(1, 3), (5, 1), (2, 2)])
def test_fewer_than_six_pieces_stay_separate(size):
    of = groups(*draw(*checks(*size, (RED, WHITE))))
    assert len(set(of)) == len(of)


def test_equal_objects_on_a_floor_stay_separate():
    boxes = [(40, 60, left, left + 20) for left in (10, 50, 90, 130)]
    of = groups(*draw(*((box, RED) for box in boxes)))
    assert len(set(of)) == len(of)


def test_touching_patterns_with_a_common_colour_stay_two():
    red = checks(4, 4, (RED, WHITE), left=30)
    blue = checks(4, 4, (BLUE, WHITE), left=30 + 4 * 12)
    _, *of = groups(*draw(*red, *blue))
    assert len(set(of[:16])) == 1 and len(set(of[16:])) == 1
    assert of[0] != of[16]


def test_check_cut_by_outline_joins_its_pattern():
    pattern = checks(3, 5, (RED, WHITE))
    (top, bottom, left, _), colour = pattern[-1]
    pattern[-1] = (top, bottom, left, left + 3), colour
    floor, *of = groups(*draw(*pattern))
    assert len(set(of)) == 1 and floor not in of


def test_stripes_at_different_depths_stay_separate():
    image, pieces = draw(*checks(1, 6, (RED, WHITE)))
    flat = np.full(SIZE, 3.0, np.float32)
    assert len(set(groups(image, pieces, flat)[1:])) == 1
    fence = np.where(pieces % 2 == 1, 1.5, 3.0).astype(np.float32)
    of = groups(image, pieces, fence)
    assert len(set(of)) == len(of)


def test_pixels_outside_regions_stay_outside():
    image, pieces = draw(*checks(4, 4, (RED, WHITE)))
    pieces -= 1
    joined = join_patterns(SeenView.alone(image).view.lab, pieces)
    np.testing.assert_array_equal(joined < 0, pieces < 0)
    assert joined.max() == 0
    nothing = np.full(SIZE, -1, np.int32)
    np.testing.assert_array_equal(join_patterns(SeenView.alone(image).view.lab, nothing), nothing)
