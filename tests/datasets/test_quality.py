"""Blur and exposure rank as eyes do, and keyframes are the sharpest along the way."""

import io

import cv2
import numpy as np
import pytest
from PIL import Image

from slgaussian import datasets
from slgaussian.datasets.sharpness import blur, choose_keyframes, exposure, glance
from slgaussian.errors import InputError
from slgaussian.scene import Camera


def jpeg(pixels: np.ndarray) -> bytes:
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "JPEG", quality=95)
    return out.getvalue()


@pytest.fixture(scope="module")
def photo():
    room = datasets.load("procedural", seed=2, views=2, height=360, width=640)
    return room.read("view_00").image


def test_blur_grows_with_motion_and_hardly_with_what_there_is_to_see(photo):
    def looked(pixels):
        return blur(glance(jpeg(pixels))[0])

    streaks = [looked(cv2.blur(photo, (width, 1))) for width in (1, 5, 9, 17)]
    assert streaks == sorted(streaks) and streaks[-1] > streaks[0] + 0.2
    door = np.full((360, 640, 3), 200, np.uint8)
    door[90:, 250:400] = 40
    little = door.copy()
    little[150:170, 300:320] = 250
    assert abs(looked(door) - looked(little)) < 0.1
    assert looked(door) < looked(cv2.blur(door, (17, 1))) - 0.2
    assert blur(np.full((50, 50), 9, np.uint8)) == blur(np.zeros((3, 90), np.uint8)) == 1


def test_exposure_counts_what_is_clipped():
    half = np.zeros((10, 20), np.uint8)
    half[:, 10:] = 255
    assert exposure(half) == (0.5, 1.0)
    assert exposure(np.full((4, 4), 128, np.uint8)) == (pytest.approx(0.502, abs=1e-3), 0)


@pytest.mark.parametrize("data", [b"", b"no image", None])
def test_what_cannot_be_decoded_is_an_error(photo, data):
    if data is None:
        data = jpeg(photo)[:5000]
    with pytest.raises(InputError, match="its JPEG cannot be decoded"):
        glance(data)


def test_keyframes_are_the_sharpest_of_the_middle_of_each_part():
    blurs = np.full(40, 0.5)
    blurs[[4, 6, 15, 23, 36]] = 0.1
    blurs[[0, 9, 30]] = 0.01  # sharper, but at the borders of parts
    assert choose_keyframes(blurs, 4) == [4, 15, 23, 36]
    rng = np.random.default_rng(0)
    for _ in range(20):
        kept = choose_keyframes(rng.random(100), 10)
        assert len(kept) == 10 and min(np.diff(kept)) >= 5
    assert choose_keyframes([0.3, 0.1, 0.2], 5) == [0, 1, 2]
    with pytest.raises(InputError, match="found 1, expected two or more"):
        choose_keyframes([0.3, 0.1], 1)


def test_standing_still_adds_no_keyframes():
    walk = []
    for x in (*([0.0] * 30), *np.linspace(0.1, 1, 10)):
        c2w = np.eye(4)
        c2w[0, 3] = x
        walk.append(Camera(np.diag([100.0, 100, 1]), c2w, 100, 80))
    kept = choose_keyframes(np.zeros(40), 5, walk)
    assert len(kept) == 5 and sum(k < 30 for k in kept) <= 1
