"""Blockwise matching against a plain one, and subpixel refinement against known shifts."""

import cv2
import numpy as np
import skimage.data

from slgaussian.cameras.matches import Features, find_features, match
from slgaussian.cameras.subpixel import sharpen


def plain_match(a: Features, b: Features, ratio: float) -> set[tuple[int, int]]:
    """Match mutual nearest neighbours by Lowe's ratio test, on all distances in float64."""
    x, y = a.descriptors.astype(np.float64), b.descriptors.astype(np.float64)
    distance = np.sqrt((2 - 2 * x @ y.T).clip(0))
    best = distance.argmin(1)
    order = np.sort(distance, 1)
    return {
        (i, int(j))
        for i, j in enumerate(best)
        if distance[:, j].argmin() == i and order[i, 0] < ratio * order[i, 1]
    }


def test_blockwise_matches_equal_plain_ones():
    left, right, _ = skimage.data.stereo_motorcycle()
    a, b = (find_features(cv2.cvtColor(i, cv2.COLOR_RGB2GRAY), 700, 0.02) for i in (left, right))
    i, j, ratios = match(a, b, 0.85)
    assert set(zip(i.tolist(), j.tolist(), strict=True)) == plain_match(a, b, 0.85)
    assert (ratios < 0.85).all() and len(i) > 100


def test_blank_image_has_no_features_and_no_matches():
    blank = find_features(np.zeros((40, 40), np.uint8), 100, 0.02)
    assert len(blank) == 0
    assert all(len(part) == 0 for part in match(blank, blank, 0.85))


def test_refinement_halves_the_error_of_a_warped_and_darkened_image():
    grey = cv2.cvtColor(skimage.data.chelsea(), cv2.COLOR_RGB2GRAY)
    turn = cv2.getRotationMatrix2D((225, 150), 11, 1.17)
    turn[:, 2] += (0.37, -0.21)
    moved = cv2.warpAffine(grey, turn, grey.shape[::-1], flags=cv2.INTER_CUBIC)
    moved = np.uint8(0.7 * moved + 20)
    a, b = find_features(grey, 1500, 0.01), find_features(moved, 1500, 0.01)
    i, j, _ = match(a, b, 0.8)
    true = (a.points[i] - 0.5) @ turn[:, :2].T + turn[:, 2] + 0.5
    before = np.linalg.norm(b.points[j] - true, axis=1)
    i, j, true = i[before < 2], j[before < 2], true[before < 2]
    after = np.linalg.norm(sharpen((grey, moved), a, b, i, j) - true, axis=1)
    assert len(i) > 200
    assert np.median(after) < 0.5 * np.median(before[before < 2])
    assert (after < 2.5).all()


def texture(seed: int, coarse: float) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=(160, 160)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), coarse)
    return np.clip(128 + 40 * smooth / smooth.std(), 0, 255).astype(np.uint8)


def grid_features(shift: float = 0.0) -> Features:
    grid = np.stack(np.meshgrid(np.arange(30, 131, 10.0), np.arange(30, 131, 10.0)), -1)
    points = grid.reshape(-1, 2) + (shift, 0)
    count = len(points)
    return Features(
        points, np.zeros((count, 128), np.float32), np.full(count, 2.0), np.zeros(count)
    )


def test_features_of_different_textures_stay():
    features = grid_features()
    i = np.arange(len(features))
    refined = sharpen((texture(0, 1.5), texture(1, 1.5)), features, features, i, i)
    assert (refined == features.points).all(1).mean() > 0.7


def test_refinement_follows_a_shift_of_one_pixel_but_not_of_four():
    picture, features = texture(0, 4.0), grid_features()
    images, i = (picture, np.roll(picture, 4, 1)), np.arange(len(features))
    far = sharpen(images, features, features, i, i)
    near = sharpen(images, features, grid_features(3.0), i, i)
    assert np.linalg.norm(far - features.points, axis=1).max() < 3
    assert np.median(np.linalg.norm(near - features.points - (4, 0), axis=1)) < 0.2
