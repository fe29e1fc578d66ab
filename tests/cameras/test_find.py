"""Cameras of two photographs, or a refusal with its reason."""

from dataclasses import replace
from functools import cache

import cv2
import hard_photographs
import numpy as np
import pytest

from slgaussian.cameras.estimated import EstimatedCameras
from slgaussian.cameras.find import FOCAL_STD_FACTOR, FOCAL_STD_FLOOR, find_cameras, focal_of
from slgaussian.cameras.two_view import Photograph
from slgaussian.errors import InputError


@cache
def room() -> list[Photograph]:
    return hard_photographs.a_room()


@cache
def estimated() -> EstimatedCameras:
    return find_cameras(room())


@pytest.mark.parametrize("case", hard_photographs.REFUSED)
def test_refused(case):
    make, reason = hard_photographs.REFUSED[case]
    with pytest.raises(InputError, match=reason):
        find_cameras(make())


@pytest.mark.parametrize("cameras", [estimated, lambda: find_cameras(hard_photographs.bikes())])
def test_answered(cameras):
    a, b = cameras().cameras.values()
    assert np.linalg.norm(b.center - a.center) == pytest.approx(1)
    assert b.center[0] > 0.98  # both pairs were taken side by side


def test_order_decides_only_about_the_frame():
    turned = find_cameras(room()[::-1])
    assert list(turned.cameras) == ["b.jpg", "a.jpg"]
    b_in_a, a_in_b = estimated().cameras["b.jpg"].c2w, turned.cameras["a.jpg"].c2w
    np.testing.assert_allclose(b_in_a @ a_in_b, np.eye(4), atol=1e-9)
    assert turned.focals == estimated().focals and turned.confidence == estimated().confidence


def test_a_photograph_given_twice_is_left_out_and_changes_no_byte():
    again = find_cameras([*room(), replace(room()[0], name="again.jpg")])
    assert again.left_out == {"again.jpg": "it is the same picture as a.jpg"}
    assert "again.jpg is left out: it is the same picture as a.jpg" in again.warnings
    for name, camera in estimated().cameras.items():
        assert camera.c2w.tobytes() == again.cameras[name].c2w.tobytes()
        assert camera.K.tobytes() == again.cameras[name].K.tobytes()


def test_focal_length_by_exif_is_nearly_believed():
    by_exif = [replace(p, lens="phone", focal=1.04 * 0.9 * p.width) for p in room()]
    cameras_by_exif = find_cameras(by_exif)
    focal = cameras_by_exif.focals["a.jpg"]
    assert focal.source == "EXIF"
    assert focal.pixels == pytest.approx(0.9 * 480, rel=0.06)
    assert focal.low < 0.9 * 480 < focal.high < 1.12 * focal.pixels
    uncertainty = cameras_by_exif.cameras["a.jpg"].estimated
    assert uncertainty.source == "EXIF"
    assert uncertainty.focal == (focal.low / focal.pixels, focal.high / focal.pixels)


def test_each_photograph_has_its_own_lens_whatever_the_order():
    a, b = room()
    larger = cv2.resize(b.image, (600, 450), interpolation=cv2.INTER_CUBIC)
    photographs = [
        Photograph("a.jpg", a.image, 480, 360, "a", 0.9 * 480),
        Photograph("b.jpg", larger, 600, 450, "b", 0.9 * 600),
    ]
    one, other = find_cameras(photographs), find_cameras(photographs[::-1])
    assert one.focals == other.focals
    assert one.focals["b.jpg"].pixels == pytest.approx(0.9 * 600, rel=0.06)


@pytest.mark.parametrize("deviation", [0.0, 0.05])
def test_interval_is_wider_than_that_of_the_matches(deviation):
    wide = np.hypot(FOCAL_STD_FACTOR * deviation, FOCAL_STD_FLOOR)
    focal = focal_of(400, deviation, room()[0])
    assert focal.high / 400 == 400 / focal.low == pytest.approx(np.exp(1.645 * wide))
