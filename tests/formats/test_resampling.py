"""Resized photographs, masks, ids and depths, compared with sums in float64."""

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest

from slgaussian.datasets.lens import lens_maps, undistort
from slgaussian.errors import InputError
from slgaussian.formats.resampling import Window
from slgaussian.scene import Camera, View

SIZES = [(60, 90), (45, 80), (31, 47), (40, 40), (120, 180), (97, 203), (7, 9), (1, 1), (150, 90)]
"""Of views of a photograph of 60x90: the same, smaller, larger, cropped, tiny; height first."""


def make_view(**truths) -> View:
    K = np.array([[80, 0, 44.0], [0, 80, 31], [0, 0, 1]])
    image = np.random.default_rng(0).integers(0, 256, (60, 90, 3)).astype(np.uint8)
    return View("a", Camera(K, np.eye(4), 90, 60), image, **truths)


def edges(view: View, full: View, axis: int) -> np.ndarray:
    """Return the edges of the view's columns (axis 0) or rows in the photograph, by its camera."""
    count = (view.camera.width, view.camera.height)[axis]
    rays = (np.arange(count + 1) - view.camera.K[axis, 2]) / view.camera.K[axis, axis]
    return rays * full.camera.K[axis, axis] + full.camera.K[axis, 2]


def box_sums(array: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Mean of an image float64 [H, W, ...] over boxes, by loops."""

    def along(array, cuts):
        out = []
        for a, b in pairwise(cuts):
            ends = np.arange(len(array))
            share = np.clip(np.minimum(ends + 1, b) - np.maximum(ends, a), 0, None) / (b - a)
            out.append(np.tensordot(share, array, 1))
        return np.stack(out)

    return np.moveaxis(along(np.moveaxis(along(array, rows), 1, 0), columns), 0, 1)


@pytest.mark.parametrize("size", SIZES)
def test_resized_mask_covers_more_than_half_of_its_pixels(size):
    drawn = np.zeros((60, 90), np.uint8)
    cv2.fillPoly(drawn, [np.array([[10, 5], [80, 20], [30, 55]])], 1)
    drawn[30:40, 60:75] = 1
    full = make_view(opaque=drawn > 0)
    view = full.resize(*size)
    cover = box_sums(drawn.astype(float), edges(view, full, 1), edges(view, full, 0))
    clear = np.abs(cover - 0.5) > 1e-4
    assert np.array_equal(view.opaque[clear], cover[clear] > 0.5)
    assert not view.opaque[np.abs(cover - 0.5) < 1e-9].any()
    # What is brought to the size in one step lies where what came with the photograph does, from
    # drawings of another size too.
    finer = np.kron(drawn, np.ones((3, 3), np.uint8))
    for other in (drawn, finer):
        assert np.array_equal(view.visible_window.mask(other, *size), view.opaque)


@pytest.mark.parametrize("size", [size for size in SIZES if size[0] * size[1] <= 60 * 90])
def test_shrunk_photograph_is_an_average_by_area(size):
    full = make_view()
    view = full.resize(*size)
    means = box_sums(full.image.astype(float), edges(view, full, 1), edges(view, full, 0))
    assert np.abs(view.image - means).max() <= 0.5 + 1e-3


@pytest.mark.parametrize("size", SIZES)
def test_resized_ids_equal_those_at_pixel_centres(size):
    ids = np.random.default_rng(1).integers(0, 9, (60, 90)).astype(np.int32)
    full = make_view(instances=ids)
    view = full.resize(*size)
    y, x = ((e[1:] + e[:-1]) / 2 for e in (edges(view, full, 1), edges(view, full, 0)))
    clear_y, clear_x = (np.abs(v - np.rint(v)) > 1e-6 for v in (y, x))  # on no border of two
    expected = ids[np.ix_(y[clear_y].astype(int), x[clear_x].astype(int))]
    assert np.array_equal(view.instances[np.ix_(clear_y, clear_x)], expected)


def plane(camera: Camera, normal, least=0.03) -> np.ndarray:
    """z-depth of the plane n . x = 3 at every pixel centre, float64; 0 beyond 1 / least."""
    inverse = camera.rays() @ np.array(normal, float) / 3
    return np.divide(1, inverse, out=np.zeros(inverse.shape), where=inverse > least)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("normal", [(0.3, 0.1, 1), (-2, 1, 1), (0.1, 1.4, 0.35)])
def test_resized_depth_of_a_plane_is_exact(size, normal):
    full = make_view()
    depth = plane(full.camera, normal).astype(np.float32)
    view = View("a", full.camera, full.image, depth).resize(*size)
    truth = plane(view.camera, normal)
    is_known = (view.depth > 0) & (truth > 0)
    assert is_known.mean() > 0.95 * (truth > 0).mean()
    assert np.abs(view.depth[is_known] / truth[is_known] - 1).max() < 1e-5


@pytest.mark.parametrize("size", SIZES)
def test_resized_depth_never_mixes_two_surfaces(size):
    """The scene is a slanted floor before a wall, with a hole; no pixel mixes both."""
    full = make_view()
    floor, wall = (plane(full.camera, n) for n in ((0.1, 1.4, 0.35), (0.1, 0, 1)))
    left = np.arange(90) < 37
    depth = np.where(left & (floor > 0), floor, wall).astype(np.float32)
    depth[20:25, 50:60] = 0
    view = View("a", full.camera, full.image, depth).resize(*size)
    surfaces = [plane(view.camera, n, 1e-3) for n in ((0.1, 1.4, 0.35), (0.1, 0, 1))]
    is_known = view.depth > 0
    off = np.min([np.abs(view.depth / np.where(s > 0, s, 99) - 1) for s in surfaces], 0)
    assert off[is_known].max() < 1e-5
    assert np.array_equal(is_known, view.visible_window.ids(depth > 0, *size))


def test_undistort_keeps_depth_of_the_surface():
    full = make_view()
    lens = np.array([0.2, 0.05, 0, 0, 0])
    K = full.camera.K
    maps = lens_maps(K, (90, 60), lens)
    # The plane in the bent photograph: where each of its pixels looks.
    u, v = np.meshgrid(np.arange(90), np.arange(60))
    pixels = np.stack([u, v], -1).reshape(-1, 1, 2).astype(float)
    shifted = K - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
    rays = cv2.undistortPoints(
        pixels, shifted, lens, criteria=(cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    ).reshape(60, 90, 2)
    bent = 3 / (rays @ [0.3, 0.1] + 1)
    mask = rays[..., 0] < 0.1
    view = undistort(replace(full, depth=bent.astype(np.float32), opaque=mask), maps)
    depth = view.depth
    truth = plane(full.camera, (0.3, 0.1, 1))
    is_known = depth > 0
    assert is_known.mean() > 0.8 * mask.mean()
    assert abs((depth[is_known] / truth[is_known] - 1).mean()) < 1e-5
    straight = full.camera.rays()[..., 0] < 0.1
    assert (view.opaque != straight)[is_known].mean() < 0.005


@pytest.mark.parametrize(
    ("fisheye", "k", "empty"), [(False, 0.35, 0.1986), (False, -0.1, 0), (True, 0.6, 0.108)]
)
def test_undistort_marks_pixels_outside_the_lens_as_unknown(fisheye, k, empty):
    width, height, focal = 640, 480, 500.0
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    camera = Camera(K, np.eye(4), width, height)
    white = View("a", camera, np.full((height, width, 3), 255, np.uint8))
    view = undistort(white, lens_maps(K, (width, height), [k], fisheye))
    # OpenCV's models, written out: from ideal to distorted radius over focal length.
    y, x = (np.indices((height, width)) + 0.5 - [[[height / 2]], [[width / 2]]]) / focal
    radius = np.hypot(x, y)
    angle = np.arctan(radius)
    scale = angle * (1 + k * angle**2) / radius if fisheye else 1 + k * radius**2
    u, v = x * scale * focal + width / 2, y * scale * focal + height / 2
    shown = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    assert (~shown).mean() == pytest.approx(empty, abs=1e-3)
    assert (view.image == np.where(shown, 255, 0)[..., None]).all()
    assert view.opaque is None if not empty else (view.opaque == shown).all()


def test_check_shape_refuses_aspect_that_differs_by_over_one_percent():
    photograph = Window.whole(988, 731)
    for size in [(988, 731), (494, 365), (994, 731), (1976, 1462), (4, 3)]:
        photograph.check_shape("a.png", *size)
    pattern = r"a\.png: is \d+x\d+, of another shape than its photograph, 988x731"
    for size in [(1004, 731), (731, 988), (731, 731), (3, 4)]:
        with pytest.raises(InputError, match=pattern):
            photograph.check_shape("a.png", *size)
