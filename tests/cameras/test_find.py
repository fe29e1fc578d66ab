"""Estimation of cameras of two photographs, and its refusals."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from hard_photographs import REFUSED, motorcycle_pair, room_pair

from slgaussian.cameras.estimated import EstimatedCameras
from slgaussian.cameras.find import FOCAL_STD_FACTOR, FOCAL_STD_FLOOR, estimate_focal, find_cameras
from slgaussian.cameras.two_view import Described, Photograph
from slgaussian.errors import InputError


@cache
def estimate_room() -> EstimatedCameras:
    return find_cameras(room_pair())


@pytest.mark.parametrize("flaw", REFUSED)
def test_hard_pair_is_refused(flaw):
    make, reason = REFUSED[flaw]
    with pytest.raises(InputError, match=reason):
        find_cameras(make())


def test_pairs_taken_side_by_side_are_placed_at_unit_distance():
    for result in (estimate_room(), find_cameras(motorcycle_pair())):
        a, b = result.cameras.values()
        assert np.linalg.norm(b.center - a.center) == pytest.approx(1)
        assert b.center[0] > 0.98


def test_order_changes_only_the_frame():
    reverse = find_cameras(room_pair()[::-1])
    assert list(reverse.cameras) == ["b.jpg", "a.jpg"]
    b_in_a, a_in_b = estimate_room().cameras["b.jpg"].c2w, reverse.cameras["a.jpg"].c2w
    np.testing.assert_allclose(b_in_a @ a_in_b, np.eye(4), atol=1e-9)
    assert reverse.focals == estimate_room().focals
    assert reverse.confidence == estimate_room().confidence


def test_duplicate_photograph_is_left_out_and_changes_no_byte():
    result = find_cameras([*room_pair(), replace(room_pair()[0], name="copy.jpg")])
    assert result.left_out == {"copy.jpg": "it is the same picture as a.jpg"}
    assert "copy.jpg is left out: it is the same picture as a.jpg" in result.warnings
    for name, camera in estimate_room().cameras.items():
        assert camera.c2w.tobytes() == result.cameras[name].c2w.tobytes()
        assert camera.K.tobytes() == result.cameras[name].K.tobytes()


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 2, 0)])
def test_the_smaller_copy_is_left_out_in_any_order(order):
    a, b = room_pair()
    small = cv2.resize(a.image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    copy = replace(a, name="copy.jpg", image=small, width=a.width // 2, height=a.height // 2)
    photographs = (a, b, copy)
    result = find_cameras([photographs[k] for k in order])
    assert result.left_out == {"copy.jpg": "it is the same picture as a.jpg"}
    with pytest.raises(InputError, match=r"'copy\.jpg': it is the same picture as a\.jpg, and no"):
        find_cameras([copy, a])


def test_focal_length_of_exif_is_used_where_the_matches_do_not_contradict_it():
    result = find_cameras(
        [replace(p, lens="phone", focal=1.04 * 0.9 * p.width) for p in room_pair()]
    )
    focal, camera = result.focals["a.jpg"], result.cameras["a.jpg"]
    assert focal.source == camera.estimated.source == "EXIF"
    assert focal.pixels == pytest.approx(0.9 * 480, rel=0.06)
    assert focal.low < 0.9 * 480 < focal.high < 1.25 * focal.pixels
    assert camera.estimated.focal == (focal.low / focal.pixels, focal.high / focal.pixels)


def test_lenses_are_estimated_per_photograph_in_any_order():
    a, b = room_pair()
    larger = cv2.resize(b.image, (600, 450), interpolation=cv2.INTER_CUBIC)
    photographs = [
        Photograph("a.jpg", a.image, 480, 360, "a", 0.9 * 480),
        Photograph("b.jpg", larger, 600, 450, "b", 0.9 * 600),
    ]
    focals = find_cameras(photographs).focals
    assert focals == find_cameras(photographs[::-1]).focals
    assert focals["b.jpg"].pixels == pytest.approx(0.9 * 600, rel=0.06)


@pytest.mark.parametrize("deviation", [0.0, 0.05])
def test_focal_interval_adds_optimism_and_model_error(deviation):
    wide = np.hypot(FOCAL_STD_FACTOR * deviation, FOCAL_STD_FLOOR)
    focal = estimate_focal(400, deviation, Described.of(room_pair()[0]))
    assert focal.high / 400 == pytest.approx(np.exp(1.645 * wide), rel=1e-4)
    assert 400 / focal.low == pytest.approx(np.exp(1.645 * wide), rel=1e-4)
