"""Measures of blur and exposure, and the choice of sharp keyframes."""

import cv2
import numpy as np
import pytest
from test_splits import jpeg

from slgaussian import datasets
from slgaussian.datasets.sharpness import blur, choose_keyframes, exposure, glance
from slgaussian.errors import InputError
from slgaussian.scene import Camera


@pytest.fixture(scope="module")
def photo():
    room = datasets.load("procedural", seed=2, views=2, height=360, width=640)
    return room.read("view_00").image


def test_blur_grows_with_motion_and_hardly_with_content(photo):
    def jpeg_blur(pixels):
        return blur(glance(jpeg(pixels))[0])

    streaks = [jpeg_blur(cv2.blur(photo, (width, 1))) for width in (1, 5, 9, 17)]
    assert streaks == sorted(streaks) and streaks[-1] > streaks[0] + 0.2
    door = np.full((360, 640, 3), 200, np.uint8)
    door[90:, 250:400] = 40
    with_sign = door.copy()
    with_sign[150:170, 300:320] = 250
    assert abs(jpeg_blur(door) - jpeg_blur(with_sign)) < 0.1
    assert jpeg_blur(door) < jpeg_blur(cv2.blur(door, (17, 1))) - 0.2
    assert blur(np.full((50, 50), 9, np.uint8)) == blur(np.zeros((3, 90), np.uint8)) == 1


def test_exposure_is_the_mean_and_the_clipped_share():
    half = np.zeros((10, 20), np.uint8)
    half[:, 10:] = 255
    assert exposure(half) == (0.5, 1.0)
    assert exposure(np.full((4, 4), 128, np.uint8)) == (pytest.approx(0.502, abs=1e-3), 0)


def test_glance_refuses_undecodable_image(photo):
    for data in (b"", b"no image", jpeg(photo)[:5000]):
        with pytest.raises(InputError, match="its JPEG cannot be decoded"):
            glance(data)


def test_keyframes_are_the_sharpest_in_the_middle_of_each_part():
    blurs = np.full(40, 0.5)
    blurs[[4, 6, 15, 23, 36]] = 0.1
    blurs[[0, 9, 30]] = 0.01  # sharper, but at borders of parts
    assert choose_keyframes(blurs, 4) == [4, 15, 23, 36]
    rng = np.random.default_rng(0)
    for _ in range(20):
        keyframes = choose_keyframes(rng.random(100), 10)
        assert len(keyframes) == 10 and min(np.diff(keyframes)) >= 5
    assert choose_keyframes([0.3, 0.1, 0.2], 5) == [0, 1, 2]
    with pytest.raises(InputError, match="found 1, expected two or more"):
        choose_keyframes([0.3, 0.1], 1)


def test_still_camera_gets_one_keyframe():
    walk = []
    for x in (*([0.0] * 30), *np.linspace(0.1, 1, 10)):
        c2w = np.eye(4)
        c2w[0, 3] = x
        walk.append(Camera(np.diag([100.0, 100, 1]), c2w, 100, 80))
    keyframes = choose_keyframes(np.zeros(40), 5, walk)
    assert len(keyframes) == 5 and sum(frame < 30 for frame in keyframes) <= 1
