"""How things lie to one another, on boxes whose places are known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.geometry import relations
from slgaussian.geometry.relations import Extent, extent, holds, joined, order
from slgaussian.scene import Camera

UP = np.array([0.0, -1.0, 0.0])
K = np.array([[300.0, 0, 200], [0, 300, 150], [0, 0, 1]])
CAMERA = Camera(K, np.eye(4), 400, 300)
PAIRS = {"left of": "right of", "above": "below", "behind": "in front of"}


def box(x, y, z, half=(0.3, 0.3, 0.3), count=6) -> np.ndarray:
    """Points on the faces of a box; y is down."""
    ticks = np.linspace(-1, 1, count)
    grid = np.stack(np.meshgrid(ticks, ticks, ticks), -1).reshape(-1, 3)
    return grid[np.abs(grid).max(1) > 0.99] * half + [x, y, z]


def seen(points, camera=CAMERA) -> Extent:
    return extent(points, camera, UP)


MIDDLE = seen(box(0, 0, 4))


@pytest.mark.parametrize(
    ("relation", "at"),
    [
        ("left of", (-1, 0, 4)),
        ("right of", (1, 0, 4)),
        ("above", (0, -1, 4)),
        ("below", (0, 1, 4)),
        ("behind", (0, 0, 6)),
        ("in front of", (0, 0, 3)),
        ("next to", (0.8, 0, 4)),
        ("on", (0, -0.62, 4)),
    ],
)
def test_every_relation_holds_where_it_should_and_nowhere_else(relation, at):
    other = seen(box(*at))
    assert holds(relation, other, MIDDLE, UP)
    assert not holds(relation, MIDDLE, MIDDLE, UP) or relation == "next to"
    opposite = PAIRS | {b: a for a, b in PAIRS.items()}
    if relation in opposite:
        assert holds(opposite[relation], MIDDLE, other, UP)
        assert not holds(opposite[relation], other, MIDDLE, UP)
    held = {one for one in (*PAIRS, *PAIRS.values(), "on") if holds(one, other, MIDDLE, UP)}
    assert held == {relation, *({"above"} if relation == "on" else ())} - {"next to"} or (
        relation == "next to" and held == {"right of"}
    )


@given(
    st.tuples(*[st.floats(-2, 2)] * 2, st.floats(3, 8)),
    st.tuples(*[st.floats(-2, 2)] * 2, st.floats(3, 8)),
)
@settings(max_examples=60, deadline=None)
def test_a_mirror_swaps_left_and_right_and_nothing_else(a, b):
    mirrored = [seen(box(*place) * [-1, 1, 1]) for place in (a, b)]
    plain = [seen(box(*place)) for place in (a, b)]
    for relation in ("above", "below", "behind", "in front of", "on", "next to"):
        assert holds(relation, *plain, UP) == holds(relation, *mirrored, UP)
    assert holds("left of", *plain, UP) == holds("right of", *mirrored, UP)
    for one, other in PAIRS.items():
        assert holds(one, *plain, UP) == holds(other, *plain[::-1], UP)
        assert not (holds(one, *plain, UP) and holds(other, *plain, UP))


@given(st.floats(0.01, 100), st.tuples(*[st.floats(-1, 1)] * 3))
@settings(max_examples=40, deadline=None)
def test_the_unit_and_the_place_of_the_world_play_no_part(scale, shift):
    pose = np.eye(4)
    pose[:3, 3] = scale * np.array(shift)
    moved = replace(CAMERA, c2w=pose)
    places = [(0, 0, 4), (-1, 0, 4), (0, -0.62, 4), (0, 0, 6), (0.8, 0.2, 4)]
    plain = [seen(box(*at)) for at in places]
    other = [seen(scale * (box(*at) + shift), moved) for at in places]
    for relation in (*PAIRS, *PAIRS.values(), "on", "next to"):
        for i in range(len(places)):
            assert holds(relation, plain[i], plain[0], UP) == holds(
                relation, other[i], other[0], UP
            )


def test_on_is_upon_a_part_of_what_is_higher_and_against_a_wall():
    chair = np.concatenate(
        [box(0, 0, 4, (0.3, 0.05, 0.3), 9), box(0, -0.5, 4.3, (0.3, 0.5, 0.03), 9)]
    )
    cushion = box(0, -0.16, 4, (0.2, 0.1, 0.2), 9)
    assert holds("on", seen(cushion), seen(chair), UP)
    wall = box(0, 0, 6, (3, 2, 0.02), 41)
    picture = box(0.5, -0.5, 5.97, (0.4, 0.3, 0.01), 21)
    assert holds("on", seen(picture), seen(wall), UP)
    beside = box(0.6, -0.05, 4, (0.25, 0.3, 0.25), 9)  # it touches the seat from the side
    assert not holds("on", seen(beside), seen(chair), UP)


def test_a_part_touches_the_whole_and_is_smaller():
    whole, part, away = box(0, 0, 4), box(0, 0.36, 4, (0.05, 0.05, 0.05)), box(2, 0, 4, (0.05,) * 3)
    assert holds("part of", seen(part), seen(whole), UP)
    assert not holds("part of", seen(whole), seen(part), UP)
    assert not holds("part of", seen(away), seen(whole), UP)


@pytest.mark.parametrize(
    ("superlative", "first"),
    [
        ("largest", 1), ("smallest", 0), ("nearest", 0), ("farthest", 2), ("leftmost", 2),
        ("rightmost", 1), ("highest", 0), ("lowest", 1), ("tallest", 2),
    ],
)  # fmt: skip
def test_the_first_in_order_is_most_so(superlative, first):
    things = [
        seen(box(0, -1, 3, (0.1, 0.1, 0.1))),
        seen(box(1, 1, 5, (0.9, 0.2, 0.9))),
        seen(box(-2, 0, 7, (0.1, 0.5, 0.1))),
    ]
    ranks = order(superlative, things)
    assert ranks[0] == first
    assert sorted(ranks) == [0, 1, 2]


def test_nearest_to_a_thing_is_not_nearest_to_the_camera():
    things = [seen(box(-2, 0, 3)), seen(box(1, 0, 6))]
    assert order("nearest", things)[0] == 0
    assert order("nearest", things, seen(box(2, 0, 7)))[0] == 1
    assert order("farthest", things, seen(box(2, 0, 7)))[0] == 0


def test_pieces_of_one_thing_are_one_and_things_apart_are_not():
    whole = box(0, 0, 4, count=21)
    left, right = whole[whole[:, 0] < 0], whole[whole[:, 0] >= 0]
    apart = box(0.9, 0, 4, count=21)
    numbers = joined([left, apart, right])
    assert numbers[0] == numbers[2] != numbers[1]
    assert len(joined([])) == 0
    # In a chain all are one; and a few stray points are no bridge.
    chain = [box(0.6 * k, 0, 4, count=21) for k in range(4)]
    assert len(set(joined(chain))) == 1
    stray = np.concatenate([left, apart[:2]])
    numbers = joined([stray, apart])
    assert numbers[0] != numbers[1]


def test_what_reaches_over_the_edge_is_cut():
    assert not seen(box(0, 0, 4)).cut
    assert seen(box(2.7, 0, 4)).cut
    assert seen(box(0, 0, 0.2)).cut


def test_single_points_have_an_extent():
    one = seen(np.array([[0.0, 0, 4]]))
    assert one.size == 0
    assert holds("left of", one, seen(box(1, 0, 4)), UP)
    assert not holds("on", one, seen(box(1, 0, 4)), UP)
    assert not relations.touching(one.points, np.array([[1.0, 0, 4]]))
