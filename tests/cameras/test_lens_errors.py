"""Lenses that the matches contradict: wrong focal lengths by EXIF, and distortion."""

import cv2
import numpy as np
import pytest
from hard_photographs import motorcycle_pair, photographs
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from slgaussian.cameras.check import check_pairs
from slgaussian.cameras.epipolar import solve, straighten
from slgaussian.cameras.find import find_cameras
from slgaussian.cameras.lens_errors import BENT, EXIF_WRONG, Lens, assume, interval, update, weigh
from slgaussian.datasets import unposed

FOCAL, SIDE = 800.0, 1000
R = Rotation.from_euler("yxz", (-14, 5, 3), degrees=True).as_matrix()
T = np.array([1.5, -0.4, 0.3])


def project(k1: float) -> tuple[np.ndarray, np.ndarray]:
    """Project points into two cameras by OpenCV, with 0.3 pixels of noise."""
    rng = np.random.default_rng(3)
    z = rng.uniform(4, 12, 500)
    points = np.stack([*rng.uniform(-0.45, 0.45, (2, 500)) * z, z], 1)
    K = np.diag([FOCAL, FOCAL, 1])
    views = (np.eye(3), np.zeros(3)), (R, T)
    seen = [
        cv2.projectPoints(points, cv2.Rodrigues(r)[0], t, K, (k1, 0, 0, 0))[0] for r, t in views
    ]
    x, y = (pixels[:, 0] + rng.normal(0, 0.3, (500, 2)) for pixels in seen)
    return x, y


def evidence(k1: float, exif: float | None):
    x, y = project(k1)
    stated = None if exif is None else (float(np.log(exif * FOCAL)), 0.05)
    lens = Lens(SIDE, stated, (float(np.log(0.8 * SIDE)), 0.3))
    best = solve(x, y, assume((lens, lens), True))[0]
    return weigh((lens, lens), True, x, y, best)[0][0]


@pytest.mark.parametrize("k1", [-0.4, -0.2, 0.1])
def test_distortion_of_opencv_is_estimated(k1):
    lens = evidence(k1, None)
    assert update(BENT, lens.bent) > 0.99
    mean, deviation = lens.bend
    assert mean * (FOCAL / SIDE) ** 2 == pytest.approx(k1, abs=0.02) and deviation < 0.05


def test_straight_lens_with_true_exif_is_not_doubted():
    lens = evidence(0.0, 1.0)
    assert update(BENT, lens.bent) < 0.2 and update(EXIF_WRONG, lens.wrong) < 0.2


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.25, 2.0])
def test_exif_of_another_field_of_view_is_contradicted(factor):
    lens = evidence(0.0, factor)
    assert update(EXIF_WRONG, lens.wrong) > 0.95
    mean, deviation = lens.focal
    assert abs(mean - np.log(FOCAL)) < 2 * deviation < 0.2


def test_true_exif_of_a_distorted_lens_is_not_blamed():
    lens = evidence(-0.3, 1.0)
    assert update(BENT, lens.bent) > 0.99 and update(EXIF_WRONG, lens.wrong) < 0.5


@pytest.mark.parametrize("bend", [-0.5, 0.2])
def test_gradients_by_observed_points_match_central_differences(bend):
    rng = np.random.default_rng(1)
    points, slopes = rng.uniform(-0.4, 0.4, (2, 40, 2))
    _, observe = straighten(points, bend)
    steps = [straighten(points + s, bend)[0] - straighten(points - s, bend)[0]
             for s in 1e-6 * np.eye(2)]  # fmt: skip
    expected = np.stack([(step * slopes).sum(1) / 2e-6 for step in steps], 1)
    np.testing.assert_allclose(observe(slopes), expected, rtol=1e-6, atol=1e-8)


def test_interval_of_a_mixture_leaves_its_tails_outside():
    components = [(0.7, 0.0, 0.05), (0.3, 0.4, 0.2)]
    low, high = interval(components, 0.05)
    for end, below in ((low, 0.05), (high, 0.95)):
        assert sum(w * norm.cdf(end, m, s) for w, m, s in components) == pytest.approx(below)


def distort(image: np.ndarray, focal: float, k1: float) -> np.ndarray:
    """Distort a photograph; the inverse of Brown's model is read from a table."""
    middle = np.array(image.shape[1::-1]) / 2
    pixels = np.stack(np.meshgrid(*map(np.arange, image.shape[1::-1])), -1) + 0.5 - middle
    seen, table = np.linalg.norm(pixels, axis=-1) / focal, np.linspace(0, 1, 10001)
    radius = np.interp(seen, table * (1 + k1 * table**2), table)
    straight = pixels * (radius / seen.clip(1e-9))[..., None] + middle - 0.5
    columns, rows = np.moveaxis(straight.astype(np.float32), -1, 0)
    return cv2.remap(image, columns, rows, cv2.INTER_LINEAR)


def test_photographs_of_a_distorted_lens_are_read_undistorted():
    straight = [photograph.image for photograph in motorcycle_pair()]
    bent = [distort(image, 741, -0.3) for image in straight]
    sample = unposed.photographs(*bent, size="original")
    assert any("bends straight lines" in text for text in sample.estimation["warnings"])
    inner = np.s_[80:420, 100:640]
    for view, true, raw in zip(sample.context, straight, bent, strict=True):
        off, before = (
            np.abs(np.float64(image) - true)[inner].mean() for image in (view.image, raw)
        )
        assert off < 0.4 * before
    (check,) = check_pairs(unposed.photographs(*bent, size=(240, 300)))
    assert check.precise > 0.9  # its matches are undistorted, resized and cropped too


def test_marks_on_both_photographs_are_ignored():
    bar = np.random.default_rng(2).integers(0, 255, (12, 185, 3), dtype=np.uint8)
    bar = cv2.resize(bar, (741, 48), interpolation=cv2.INTER_CUBIC)
    marked = [np.concatenate([bar, p.image[48:]]) for p in motorcycle_pair()]
    plain, result = find_cameras(motorcycle_pair()), find_cameras(photographs(*marked))
    a, b = (r.cameras["b.jpg"].c2w for r in (plain, result))
    np.testing.assert_allclose(a, b, atol=0.05)
