"""Cameras, views and samples: conventions, and what is refused."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.errors import InputError
from slgaussian.scene import PAPER_PIXELS, Camera, Sample, Scene, View


def pose(x=0.0, y=0.0, z=0.0, yaw=0.0) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    c2w = np.eye(4)
    c2w[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    c2w[:3, 3] = x, y, z
    return c2w


def camera(width=32, height=24, focal=30.0, **where) -> Camera:
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Camera(K, pose(**where), width, height)


def view(name="a", cam=None) -> View:
    cam = cam or camera()
    start = sum(name.encode())  # another picture for another name
    ramp = np.arange(start, start + cam.height * cam.width * 3) % 255
    return View(name, cam, ramp.reshape(cam.height, cam.width, 3).astype(np.uint8))


def test_the_top_left_pixel_centre_is_at_one_half():
    cam = camera()
    pixels, z = cam.project(cam.unproject(np.full((24, 32), 2.0)))
    np.testing.assert_allclose(pixels[0, 0], (0.5, 0.5), atol=1e-9)
    np.testing.assert_allclose(z, 2.0)


@given(st.floats(-3, 3), st.floats(-5, 5), st.floats(-5, 5), st.floats(0.1, 50))
def test_unproject_inverts_project(yaw, x, z, depth):
    cam = camera(x=x, z=z, yaw=yaw)
    pixels, in_front = cam.project(cam.unproject(np.full((24, 32), depth)))
    np.testing.assert_allclose(in_front, depth, rtol=1e-9)
    np.testing.assert_allclose(pixels[5, 7], (7.5, 5.5), atol=1e-7)


def test_a_camera_shows_pixels_from_the_first_up_to_the_last_edge():
    pixels = np.array([[0, 0], [31.9, 23.9], [32, 5], [5, 24], [-0.1, 5], [5, 5], [5, 5]])
    depth = np.array([1, 1, 1, 1, 1, 0, -1.0])
    assert camera().shows(pixels, depth).tolist() == [True, True] + 5 * [False]


def test_resizing_and_cropping_move_the_image_with_the_camera():
    cam = camera()
    point = np.array([0.4, -0.2, 3.0])
    before, _ = cam.project(point)
    after, _ = cam.resize(64, 72).crop(3, 5, 40, 50).project(point)
    np.testing.assert_allclose(after, before * (2, 3) - (3, 5))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"c2w": np.diag([2.0, 2, 2, 1])}, "not a rotation"),
        ({"c2w": np.diag([-1.0, 1, 1, 1])}, "not a rotation"),
        ({"c2w": np.full((4, 4), np.nan)}, "NaN"),
        ({"c2w": np.eye(3)}, r"expected \(4, 4\)"),
        ({"c2w": np.vstack([np.eye(4)[:3], [0, 0, 1, 1]])}, "last row"),
        ({"K": np.full((3, 3), np.inf)}, "NaN or infinity"),
        ({"K": np.diag([-5.0, 5, 1])}, "must be positive"),
        ({"width": 0}, "at least 1x1"),
        ({"near": -1.0}, "near"),
        ({"near": 2.0, "far": 1.0}, "above near"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(change, sentence):
    good = {"K": camera().K, "c2w": np.eye(4), "width": 32, "height": 24}
    with pytest.raises(InputError, match=sentence):
        Camera(**{**good, **change})


@pytest.mark.parametrize("size", [(11, 15), (24, 32), (37, 50)])
def test_resized_truths_are_those_of_pixels_and_no_mixtures(size):
    """Resizing makes no id 46 between objects 2 and 90, and no depth between two surfaces."""
    full = view(cam=camera())
    left = np.arange(32) < 13
    ids = np.where(left, 2, 90).astype(np.int32)[None].repeat(24, 0)
    depth = np.where(left, 1.0, 5.0).astype(np.float32)[None].repeat(24, 0)
    resized = replace(full, instances=ids, depth=depth).resize(*size)
    assert resized.instances.shape == resized.depth.shape == size
    assert set(np.unique(resized.instances)) == {2, 90}
    np.testing.assert_array_equal(resized.depth, np.where(resized.instances == 2, 1.0, 5.0))
    # The border stays where it was, to a pixel.
    assert abs((resized.instances[0] == 2).sum() - 13 / 32 * size[1]) <= 1


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"image": np.zeros((10, 10, 3), np.uint8)}, "check w and h"),
        ({"image": np.zeros((24, 32, 3), np.float32)}, "'a': image is float32.*expects uint8"),
        ({"image": np.zeros((24, 32, 3), np.int16)}, "'a': image is int16.*expects uint8"),
        ({"depth": np.zeros((32, 24))}, r"depth is \(32, 24\), expected \(24, 32\)"),
        ({"instances": np.zeros((32, 24))}, r"instances is \(32, 24\), expected \(24, 32\)"),
        ({"opaque": np.zeros((32, 24))}, r"opaque is \(32, 24\), expected \(24, 32\)"),
    ],
)
def test_what_does_not_fit_the_camera_is_refused(changed, sentence):
    with pytest.raises(InputError, match=sentence):
        replace(view(), **changed)


@pytest.mark.parametrize(
    ("others", "sentence"),
    [
        ([], "at least two"),
        ([camera(width=40, x=1)], "must have one size"),
        ([camera(yaw=0.2)], "no baseline"),
    ],
)
def test_views_that_are_no_sample_are_refused(others, sentence):
    views = [view(name, cam) for name, cam in zip("ab", [camera(), *others], strict=False)]
    with pytest.raises(InputError, match=sentence):
        Sample("s", tuple(views))


def test_one_picture_with_two_poses_is_refused_unless_it_is_blank():
    with pytest.raises(InputError, match="'a' and 'b' are the same picture"):
        Sample("s", (view("a"), replace(view("a", camera(x=1)), name="b")))
    blank = np.full((24, 32, 3), 180, np.uint8)
    views = (replace(v, image=blank) for v in (view("a"), view("b", camera(x=1))))
    assert len(Sample("s", tuple(views)).context) == 2


def test_a_view_named_twice_is_refused_in_those_words():
    cams = {"images/a.png": camera(), "images/b.png": camera(x=1)}
    scene = Scene("s", cams, lambda name: view(name, cams[name]))
    with pytest.raises(InputError, match=r"the context names .* twice"):
        scene.sample(["a.png", "images/a.png"])
    assert len(scene.sample(["a", "b"], targets=["a"]).targets) == 1


def test_large_photographs_are_shrunk_and_small_ones_left_alone():
    cams = {"big": camera(2000, 3000, 2500.0), "big2": camera(2000, 3000, 2500.0, x=1)}
    scene = Scene("s", cams, lambda name: view(name, cams[name]))
    shrunk = scene.sample(["big", "big2"]).context[0]
    height, width = shrunk.image.shape[:2]
    assert height * width == pytest.approx(PAPER_PIXELS, rel=0.01)
    assert height / width == pytest.approx(1.5, abs=0.01)
    assert scene.sample(["big", "big2"], size="original").context[0].image.shape[0] == 3000
    small = {"a": camera(), "b": camera(x=1)}
    scene = Scene("s", small, lambda name: view(name, small[name]))
    for size, wanted in (("auto", (24, 32)), ("at most 12x16", (12, 16))):
        assert scene.sample(["a", "b"], size=size).context[0].image.shape == (*wanted, 3)


def test_a_view_answers_to_its_short_names():
    names = ("images/a.png", "images/b.png", "left/c.png", "right/c.png")
    scene = Scene("room", dict.fromkeys(names, camera()), view)
    for name in ("images/a.png", "a.png", "a", "images/a"):
        assert scene.find(name) == "images/a.png"
    with pytest.raises(InputError, match="ambiguous"):
        scene.find("c.png")
    with pytest.raises(InputError, match=r"no view 'd.png'.*images/a.png"):
        scene.find("d.png")


@pytest.mark.parametrize(
    ("sizes", "warning"),
    [
        ([(1600, 1200), (120, 90), (1600, 1200)], "'b' has 120x90 pixels, .* 5% of the pixels"),
        ([(80, 60), (1600, 1200)], "'a' has 80x60 pixels, .* 2% of the pixels"),
        (
            [(1600, 1200), (1600, 1200), (3000, 200)],
            "'c' has 3000x200 pixels, .* 17% of the pixels",
        ),
        ([(1600, 1200), (1200, 1600), (1920, 1080)], None),
        ([(640, 480), (1600, 1200), (4000, 3000)], None),
    ],
)
def test_photograph_that_leaves_few_pixels_of_the_others_is_named(sizes, warning, recwarn):
    cameras = {
        n: camera(w, h, focal=w, x=i)
        for i, (n, (w, h)) in enumerate(zip("abc", sizes, strict=False))
    }
    scene = Scene("s", cameras, lambda name: view(name, cameras[name]))
    scene.sample(list(cameras))
    scene.sample(list(cameras), size=(30, 40))
    assert len(recwarn) == (warning is not None)
    assert warning is None or re.search(warning, str(recwarn[0].message))


def test_pixels_that_are_not_square_are_named():
    K = np.array([[900.0, 0, 480], [0, 500, 270], [0, 0, 1]])
    with pytest.warns(UserWarning, match="of 'a' are 900 across and 500 pixels down"):
        Scene("s", {"a": Camera(K, np.eye(4), 960, 540)}, lambda name: None)
