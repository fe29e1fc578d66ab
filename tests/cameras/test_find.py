"""Cameras of two photographs: their frame, what EXIF says, and what the order changes."""

from dataclasses import replace
from functools import cache

import cv2
import hard_photographs
import numpy as np
import pytest

from slgaussian.cameras.estimated import EstimatedCameras
from slgaussian.cameras.find import MODEL, OPTIMISM, find_cameras, focal_of
from slgaussian.cameras.two_view import Photograph


@cache
def room() -> list[Photograph]:
    return hard_photographs.ANSWERED["a room"]()


@cache
def found() -> EstimatedCameras:
    return find_cameras(room())


def test_order_decides_only_about_the_frame():
    turned = find_cameras(room()[::-1])
    assert list(turned.cameras) == ["b.jpg", "a.jpg"]
    b_in_a = found().cameras["b.jpg"].c2w
    a_in_b = turned.cameras["a.jpg"].c2w
    np.testing.assert_allclose(b_in_a @ a_in_b, np.eye(4), atol=1e-9)
    assert turned.focals == found().focals
    assert turned.confidence == found().confidence


def test_same_photographs_same_bytes():
    again = find_cameras(room())
    for name, camera in found().cameras.items():
        assert camera.c2w.tobytes() == again.cameras[name].c2w.tobytes()
        assert camera.K.tobytes() == again.cameras[name].K.tobytes()


def test_a_photograph_given_twice_is_left_out_as_if_given_once():
    again = find_cameras([*room(), replace(room()[0], name="again.jpg")])
    assert again.left_out == {"again.jpg": "it is the same picture as a.jpg"}
    assert "again.jpg is left out: it is the same picture as a.jpg" in again.warnings
    for name, camera in found().cameras.items():
        assert camera.c2w.tobytes() == again.cameras[name].c2w.tobytes()


def test_what_exif_says_is_nearly_believed():
    told = [replace(p, lens="phone", focal=1.04 * 0.9 * p.width) for p in room()]
    focal = find_cameras(told).focals["a.jpg"]
    assert focal.source == "EXIF"
    assert focal.pixels == pytest.approx(0.9 * 480, rel=0.06)
    assert focal.low < 0.9 * 480 < focal.high < 1.12 * focal.pixels


def test_each_photograph_keeps_its_own_lens_whatever_the_order():
    a, b = room()
    larger = cv2.resize(b.image, (600, 450), interpolation=cv2.INTER_CUBIC)
    known = [
        Photograph("a.jpg", a.image, 480, 360, "a", 0.9 * 480),
        Photograph("b.jpg", larger, 600, 450, "b", 0.9 * 600),
    ]
    one, other = find_cameras(known), find_cameras(known[::-1])
    assert one.focals == other.focals
    assert one.focals["b.jpg"].pixels == pytest.approx(0.9 * 600, rel=0.06)


def test_interval_is_wider_than_what_matches_say_of_themselves():
    photograph = room()[0]
    for deviation in (0.0, 0.05):
        known = np.hypot(OPTIMISM * deviation, MODEL)
        focal = focal_of(400, deviation, photograph)
        assert focal.high / 400 == 400 / focal.low == pytest.approx(np.exp(1.645 * known))
