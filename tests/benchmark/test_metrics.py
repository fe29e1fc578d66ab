import math

import numpy as np
import plain
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import gaussian_filter

from slgaussian.benchmark import metrics


@given(arrays(bool, st.tuples(st.integers(1, 70), st.integers(1, 90))), st.integers(0, 2**32 - 1))
def test_boundary_iou_equals_erosion_by_single_pixels(mask, seed):
    other = mask ^ (np.random.default_rng(seed).random(mask.shape) < 0.1)
    assert metrics.boundary_iou(mask, other) == plain.boundary_iou(mask, other)


def test_class_ious_omit_absent_classes():
    labels = np.array([[1, 1, 2, 0]])
    truths = [labels < 2, labels > 2, labels == 2]
    assert metrics.class_ious(labels, truths) == [2 / 3, None, 0]
    assert metrics.exact_accuracy(labels, truths) == 2 / 4


@pytest.mark.parametrize(
    ("point", "hit"),
    [((2, 1), True), ((2.99, 1.99), True), ((1.99, 1), False), ((-1, 1), False), ((4, 1), False)]
    + [((2, -1), False), ((2, 3), False), (None, False)],
)
def test_point_in_mask_uses_the_pixel_around_the_point(point, hit):
    mask = np.zeros((3, 4), bool)
    mask[1, 2:] = mask[:, 2] = True  # also where an index of -1 leads
    assert metrics.point_in_mask(point, mask) is hit


@pytest.mark.parametrize(
    ("point", "hit"),
    [((10, 40), True), ((55, 5), True), ((31, 30), False), ((20, 41), False), ((9, 30), False)]
    + [((20, 19), False), (None, False)],
)
def test_point_in_boxes_includes_bounds(point, hit):
    boxes = np.array([[10.0, 20.0, 30.0, 40.0], [50.0, 0.0, 60.0, 5.0]])
    assert metrics.point_in_boxes(point, boxes) is hit
    assert not metrics.point_in_boxes(point, np.zeros((0, 4)))
    # One pixel of a peak is enough.
    peak = np.zeros((50, 70), bool)
    assert not metrics.any_in_boxes(peak, boxes)
    if point is not None:
        peak[0, 0] = peak[point[::-1]] = True
        assert metrics.any_in_boxes(peak, boxes) is hit
        assert not metrics.any_in_boxes(peak, np.zeros((0, 4)))


DEPTHS = arrays(np.float32, (4, 5), elements=st.sampled_from([0.0, 0.5, 0.9, 1.0, 1.2, 1.3, 8.0]))


@settings(max_examples=60)
@given(DEPTHS, DEPTHS, st.floats(1, 100))
def test_depth_errors_equal_a_plain_loop(predicted, truth, scale):
    pairs = zip(predicted.ravel().tolist(), truth.ravel().tolist(), strict=True)
    pairs = [(d, t) for d, t in pairs if t > 0]
    expected = {
        "abs_rel": [abs(d - t) / t for d, t in pairs],
        "delta125": [d > 0 and max(d / t, t / d) < 1.25 for d, t in pairs],
        "bad2": [d == 0 or abs(scale / d - scale / t) > 2 for d, t in pairs],
    }
    actual = metrics.depth_errors(predicted, truth, scale)
    means = {name: np.mean(values) for name, values in expected.items() if values}
    assert actual == pytest.approx(means, abs=1e-12)
    assert "bad2" not in metrics.depth_errors(predicted, truth)


def test_psnr_equals_known_values():
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
def test_ssim_equals_its_definition(seed, noise):
    rng = np.random.default_rng(seed)
    a = gaussian_filter(rng.uniform(0, 255, (24, 31, 3)), (2, 2, 0))
    b = np.clip(a + rng.normal(0, noise, a.shape), 0, 255)
    a, b = a.astype(np.uint8), b.astype(np.uint8)
    assert metrics.ssim(a, b) == pytest.approx(plain_ssim(a, b), abs=1e-10)
