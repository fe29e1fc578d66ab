import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import gaussian_filter

from slgaussian.benchmark import metrics

MASKS = arrays(bool, (5, 7))


def loop_iou(a, b):
    both = either = 0
    for p, q in zip(a.ravel().tolist(), b.ravel().tolist(), strict=True):
        both += p and q
        either += p or q
    return both / either if either else 1.0


@given(MASKS, MASKS)
def test_iou_is_that_of_a_plain_loop(a, b):
    assert metrics.iou(a, b) == loop_iou(a, b) == metrics.iou(b, a)


@given(arrays(np.int32, (5, 7), elements=st.integers(0, 3)), arrays(bool, (3, 5, 7)))
def test_class_ious_are_those_of_a_plain_loop(labels, truths):
    expected = [
        loop_iou(np.array(labels == k + 1), truth) if truth.sum() > 0 else None
        for k, truth in enumerate(truths)
    ]
    assert metrics.class_ious(labels, truths) == expected


@given(arrays(np.int32, (5, 7), elements=st.integers(0, 3)), arrays(bool, (3, 5, 7)))
def test_a_pixel_is_right_only_if_all_its_bits_are(labels, truths):
    """One bit a class, as scikit-learn compares rows; but where nothing wins, nothing is right."""
    right = 0
    for y in range(5):
        for x in range(7):
            told = [labels[y, x] == k + 1 for k in range(3)]
            right += any(told) and told == [bool(truth[y, x]) for truth in truths]
    assert metrics.exact_accuracy(labels, truths) == right / 35


def test_a_point_hits_the_pixel_that_holds_it():
    mask = np.zeros((3, 4), bool)
    mask[1, 2] = True
    assert metrics.point_in_mask((2, 1), mask)
    assert metrics.point_in_mask((2.99, 1.99), mask)
    assert not metrics.point_in_mask((1.99, 1), mask)
    assert not metrics.point_in_mask((-1, 0), np.ones((3, 4), bool))
    assert not metrics.point_in_mask((4, 0), np.ones((3, 4), bool))
    assert not metrics.point_in_mask(None, np.ones((3, 4), bool))


def test_box_bounds_are_included():
    boxes = np.array([[10.0, 20.0, 30.0, 40.0], [50.0, 0.0, 60.0, 5.0]])
    assert metrics.point_in_boxes((10, 40), boxes)
    assert metrics.point_in_boxes((55, 5), boxes)
    assert not metrics.point_in_boxes((31, 30), boxes)
    assert not metrics.point_in_boxes((20, 41), boxes)
    assert not metrics.point_in_boxes((20, 30), np.zeros((0, 4)))
    assert not metrics.point_in_boxes(None, boxes)


DEPTHS = arrays(np.float32, (4, 5), elements=st.sampled_from([0.0, 0.5, 0.9, 1.0, 1.2, 1.3, 8.0]))


@settings(max_examples=60)
@given(DEPTHS, DEPTHS, st.floats(1, 100))
def test_depth_errors_are_those_of_a_plain_loop(predicted, truth, scale):
    relative, within, bad = [], [], []
    for d, t in zip(predicted.ravel().tolist(), truth.ravel().tolist(), strict=True):
        if t == 0:
            continue
        relative.append(abs(d - t) / t)
        within.append(d > 0 and max(d / t, t / d) < 1.25)
        bad.append(d == 0 or abs(scale / d - scale / t) > 2)
    found = metrics.depth_errors(predicted, truth, scale)
    if not relative:
        assert found == {}
        return
    assert found["abs_rel"] == pytest.approx(np.mean(relative), abs=1e-12)
    assert found["delta125"] == np.mean(within)
    assert found["bad2"] == np.mean(bad)
    assert "bad2" not in metrics.depth_errors(predicted, truth)


def test_psnr_known_values():
    image = np.full((8, 8, 3), 100, np.uint8)
    assert metrics.psnr(image, image) == math.inf
    assert metrics.psnr(image, image + 1) == pytest.approx(20 * math.log10(255), abs=1e-12)
    # uint8 differences must not wrap around.
    assert metrics.psnr(image, image - 1) == metrics.psnr(image, image + 1)


def plain_ssim(a, b):
    """Wang et al. 2004, equation 13, channel by channel, ignoring the half window at the border."""
    scores = []
    for x, y in zip(np.moveaxis(a, 2, 0), np.moveaxis(b, 2, 0), strict=True):
        x, y = x.astype(np.float64), y.astype(np.float64)

        def blur(values):
            return gaussian_filter(values, 1.5, truncate=3.5)

        mx, my = blur(x), blur(y)
        vx, vy, vxy = blur(x * x) - mx**2, blur(y * y) - my**2, blur(x * y) - mx * my
        c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
        score = (2 * mx * my + c1) * (2 * vxy + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))
        scores.append(score[5:-5, 5:-5].mean())
    return float(np.mean(scores))


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.floats(0, 60))
def test_ssim_is_that_of_the_definition(seed, noise):
    rng = np.random.default_rng(seed)
    a = gaussian_filter(rng.uniform(0, 255, (24, 31, 3)), (2, 2, 0))
    b = np.clip(a + rng.normal(0, noise, a.shape), 0, 255)
    a, b = a.astype(np.uint8), b.astype(np.uint8)
    assert metrics.ssim(a, b) == pytest.approx(plain_ssim(a, b), abs=1e-10)
    assert metrics.ssim(a, a) == pytest.approx(1.0, abs=1e-12)


def test_one_pixel_of_a_peak_in_a_box_is_enough():
    peak = np.zeros((5, 6), bool)
    peak[4, 1:3] = True
    for box, hit in (((2, 4, 9, 9), True), ((3, 0, 5, 4), False), ((0, 0, 1, 4), True)):
        assert metrics.any_in_boxes(peak, np.array([box], float)) is hit
    assert metrics.any_in_boxes(peak, np.array([[5, 0, 5, 0], [1, 4, 1, 4]], float))
    assert not metrics.any_in_boxes(peak, np.zeros((0, 4)))
    assert not metrics.any_in_boxes(np.zeros((5, 6), bool), np.array([[0, 0, 9, 9.0]]))
