"""Cross-view check, speckles, planes, fill and weighted median."""

import numpy as np
import pytest
from textured_planes import DISTANCE, NORMAL, Plane, camera

from slgaussian.cameras.relative import Relative
from slgaussian.predict.depth_completion import (
    AGREES,
    BEHIND,
    IN_FRONT,
    UNSEEN,
    cross_check,
    fill_depth,
    fit_planes,
    remove_speckles,
    weighted_median,
)

# Written out, not imported: a slip in the module must show here.
MEDIAN_COLOR, MEDIAN_RADIUS = 40.0, 7

A, B = camera(), camera(x=0.3, z=0.1, turn=0.05)
PLANE = Plane(NORMAL, DISTANCE)
STEPS = np.linspace(0.1, 1.0, 91)


def inverse(view_camera):
    return (1 / PLANE.depth(view_camera)).astype(np.float32)


def test_two_views_of_one_plane_agree_wherever_both_see_it():
    relative = Relative.between(A, B)
    verdict = cross_check(inverse(A), inverse(B), relative, 0.01)
    assert set(np.unique(verdict)) == {UNSEEN, AGREES}
    pixels, z = B.project(A.unproject(PLANE.depth(A)))
    inside = (z > 0) & (pixels >= 0).all(-1) & (pixels < (160, 120)).all(-1)
    assert ((verdict == AGREES) == inside).mean() > 0.9999


@pytest.mark.parametrize(("factor", "expected"), [(1.3, IN_FRONT), (0.7, BEHIND)])
def test_a_nearer_point_is_seen_through_and_a_farther_one_hidden(factor, expected):
    verdict = cross_check(inverse(A) * factor, inverse(B), Relative.between(A, B), 0.001)
    inside = verdict != UNSEEN
    assert inside.mean() > 0.6
    assert (verdict[inside] == expected).all()


def test_unknown_depth_refutes_nothing():
    unknown = np.full((120, 160), np.inf, np.float32)
    verdict = cross_check(inverse(A), unknown, Relative.between(A, B), 0.01)
    assert not np.isin(verdict, (AGREES, IN_FRONT)).any()


def test_speckles_go_and_large_patches_stay():
    index = np.full((40, 60), 10.0, np.float32)
    index[10:13, 10:13] = 20
    keep = np.ones((40, 60), bool)
    out = remove_speckles(index, keep, size=30)
    assert not out[10:13, 10:13].any()
    assert out.sum() == keep.sum() - 9
    assert not remove_speckles(index, np.zeros_like(keep), size=30).any()


def two_planes(noise=0.0):
    """Two planes meeting in the middle column, with a block of outliers; true map and its noise."""
    y, x = np.mgrid[:120, :160].astype(np.float64)
    left, right = np.array([0.001, 0.0005, 0.3]), np.array([-0.002, 0.001, 0.7])
    truth = np.where(x < 80, left[0] * x + left[1] * y + left[2], 0)
    truth = np.where(x >= 80, right[0] * x + right[1] * y + right[2], truth)
    noisy = truth + noise * np.random.default_rng(0).standard_normal(truth.shape)
    return truth, noisy.astype(np.float32), (left, right)


@pytest.mark.parametrize("seed", range(4))
def test_both_planes_are_found_among_outliers(seed):
    _, noisy, expected = two_planes(noise=0.002)
    rng = np.random.default_rng(seed)
    outlier = rng.random(noisy.shape) < 0.2
    noisy[outlier] = rng.uniform(0.1, 1, outlier.sum())
    planes = fit_planes(noisy, np.ones(noisy.shape, bool), 0.01)
    assert len(planes) >= 2
    corners = np.array([[0, 0, 1], [0, 119, 1], [80, 0, 1], [80, 119, 1]])
    for plane in expected:
        off = np.abs((planes - plane) @ corners.T).max(1).min()
        # 0.002 of noise over thousands of pixels; outliers inside the tolerance pull a little:
        # measured 0.0003 to 0.0006.
        assert off < 0.002


def test_fill_continues_planes_up_to_the_image_edge_between_them():
    truth, exact, expected = two_planes()
    keep = np.ones(exact.shape, bool)
    keep[40:80, 60:100] = False
    guide = np.where(np.arange(160) < 80, 60, 180) * np.ones((120, 1))
    broken = np.where(keep, exact, np.float32(0.95))
    out = fill_depth(broken, keep, guide.astype(np.uint8), np.array(expected), STEPS, [])
    assert np.array_equal(out[keep], exact[keep])
    assert np.abs(out - truth).max() < 1e-5


def test_fill_avoids_what_another_view_sees_through():
    a, b = camera(), camera(x=0.3)
    keep = np.zeros((120, 160), bool)
    keep[:, :20] = True
    truth = np.full((120, 160), 0.3, np.float32)
    planes = np.array([[0, 0, 0.6], [0, 0, 0.3]])
    near = np.where(keep, np.float32(0.6), truth)
    blank = np.zeros((120, 160), np.uint8)
    # Alone, the answered strip spreads its near plane; the other view knows that space is free.
    alone = fill_depth(near, keep, blank, planes, STEPS, [])
    assert (alone == np.float32(0.6)).all()
    view = fill_depth(near, keep, blank, planes, STEPS, [(Relative.between(a, b), truth)])
    assert (view[:, 60:] == np.float32(0.3)).mean() > 0.9


def plain_median(values, image, y, x):
    """Weighted median of every other pixel of one window by sorting, float64."""
    rows = slice(max(y - MEDIAN_RADIUS, 0), y + MEDIAN_RADIUS + 1)
    columns = slice(max(x - MEDIAN_RADIUS, 0), x + MEDIAN_RADIUS + 1)
    off = np.abs(image[rows, columns].astype(float) - image[y, x].astype(float)).sum(-1)
    j, i = np.indices(values.shape)[:, rows, columns]
    picked = (i + j + x + y) % 2 == 0
    weight = np.exp(-0.5 * (off / MEDIAN_COLOR) ** 2)[picked]
    value = values[rows, columns].astype(np.float64)[picked]
    order = np.argsort(value)
    half = np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2)
    return value[order][half]


def test_weighted_median_is_near_the_sorted_one():
    rng = np.random.default_rng(0)
    values = rng.uniform(0.1, 1.0, (40, 50)).astype(np.float32)
    image = rng.integers(0, 256, (40, 50, 3), dtype=np.uint8)
    step = 0.01
    fast = weighted_median(values, image, 0.1, step)
    plain = [[plain_median(values, image, y, x) for x in range(50)] for y in range(40)]
    # Half a bin (a quarter step) for the bin, and the mean reaches 1.75 steps to either side.
    assert np.abs(fast - plain).max() < 2 * step
