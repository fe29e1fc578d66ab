import io

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from PIL import Image
from skimage.color import rgb2lab

from slgaussian.benchmark import pictures


@pytest.fixture(scope="module")
def photo() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (60, 80, 3), np.uint8)


def test_label_colors_differ_between_objects():
    lab = rgb2lab(pictures.label_colours(np.arange(1, 25))[None] / 255)[0]
    distances = np.linalg.norm(lab[:, None] - lab[None], axis=-1)
    # A CIELAB difference of about 2.3 is just noticed; these are six times that apart.
    assert distances[~np.eye(len(lab), dtype=bool)].min() > 14
    # The next id, often the neighbour in the image, differs much more.
    assert np.diagonal(distances, 1).min() > 40


@given(st.lists(st.floats(0.5, 20), min_size=2, max_size=8, unique=True))
def test_paint_depth_paints_near_red_and_unknown_dark(depths):
    near, far = min(depths), max(depths)
    assume(far > 1.001 * near)  # nearer by rounding alone is one colour
    ((nearest, farthest, unknown),) = pictures.paint_depth(np.array([[near, far, 0.0]]), near, far)
    assert nearest[0] > nearest[2] and farthest[2] > farthest[1]
    assert unknown.tolist() == [28, 28, 28]


def test_paint_relevancy_range_covers_present_values(photo):
    grey = np.full((60, 80, 3), 90, np.uint8)
    painted, wide = (
        pictures.paint_relevancy_range(np.tile(np.linspace(*ends, 80), (60, 1)), grey)
        for ends in ((0.40, 0.44), (0.1, 1))
    )
    assert np.array_equal(painted[:40], wide[:40])  # below them stand the ends, which differ
    # The lower half is the grey photograph, the upper has colour, the best the brightest.
    assert (np.ptp(painted[:40, :40].astype(int), axis=-1) == 0).all()
    assert (np.ptp(painted[:40, 50:].astype(int), axis=-1) > 20).all()
    assert painted[:40].sum((0, 2)).argmax() == 79
    flat = np.full((60, 80), 0.7)
    flat[:, :20] = 0  # where nothing is drawn
    for constant in (flat, 0 * flat):
        assert (np.ptp(pictures.paint_relevancy_range(constant, photo), axis=-1) == 0).all()


def test_drawing_does_not_change_its_input(photo):
    before, mask = photo.copy(), np.zeros((60, 80), bool)
    mask[20:40, 30:50] = True
    outlined = pictures.draw_outline(photo, mask, pictures.TRUE_COLOUR)
    pointed = pictures.draw_point(photo, (40, 30))
    assert np.array_equal(photo, before)
    # The outline runs along the mask: nothing changes deep inside or far away.
    assert (outlined != photo).any(-1)[20, 30:50].all()
    assert np.array_equal(outlined[27:33, 37:43], photo[27:33, 37:43])
    assert np.array_equal(outlined[:10], photo[:10])
    assert pointed[30, 40].tolist() == list(pictures.POINT_COLOUR)
    assert pictures.draw_point(photo, None) is photo


def test_encode_png_is_exact_with_one_bit_per_mask_pixel(photo):
    for image, mode in ((photo, "RGB"), (photo[..., 0] > 127, "1")):
        decoded = Image.open(io.BytesIO(pictures.encode_png(image)))
        assert decoded.mode == mode and np.array_equal(np.asarray(decoded), image)


def test_cut_out_uses_the_view_of_the_largest_box(photo):
    other = 255 - photo
    boxes = [[[5, 10, 25, 20], [0, 0, 10, 10]], [[0, 0, 0, 0], [70, 50, 80, 60]]]
    labels = np.full((2, 60, 80), 4)
    labels[0, 10:20, 5:15] = 3
    cuts = pictures.cut_out([photo, other], labels, np.array([3, 4]), np.array(boxes, np.int32))
    np.testing.assert_array_equal(cuts[0][:, :10], photo[10:20, 5:15])
    assert (cuts[0][:, 10:] >= 191).all()  # another object is pale
    np.testing.assert_array_equal(cuts[1], other[50:60, 70:80])
