"""Scenes of photographs without cameras, read from folders, files and memory."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from taken_photographs import stereo_pair, write_photograph

import slgaussian as slg
from slgaussian import datasets
from slgaussian.cameras.estimated import GOOD, EstimatedCameras, EstimatedPair, Focal
from slgaussian.datasets import unposed
from slgaussian.errors import InputError
from slgaussian.scene import Camera, Estimated


def side_by_side(photographs):
    """Return cameras side by side that look ahead, in place of those of :func:`find_cameras`."""
    cameras, focals = {}, {}
    for number, photo in enumerate(photographs):
        f = photo.focal or 0.8 * max(photo.width, photo.height)
        K = np.array([[f, 0, photo.width / 2], [0, f, photo.height / 2], [0, 0, 1]])
        pose = np.eye(4)
        pose[0, 3] = number
        camera = Camera(K, pose, photo.width, photo.height)
        cameras[photo.name] = replace(camera, estimated=Estimated((0.9, 1.1), "guess", 0.75))
        focals[photo.name] = Focal(f, 0.9 * f, 1.1 * f, "guess")
    pairs = (EstimatedPair(tuple(cameras)[:2], 200, 150, float("nan"), 1.0, GOOD, ""),)
    return EstimatedCameras(cameras, focals, pairs, 0.75)


@pytest.fixture
def find_calls(monkeypatch):
    """Names of photographs in every call of the replaced :func:`find_cameras`."""
    calls = []

    def find(photographs):
        calls.append([photograph.name for photograph in photographs])
        return side_by_side(photographs)

    monkeypatch.setattr(unposed, "find_cameras", find)
    unposed._find.cache_clear()
    yield calls
    unposed._find.cache_clear()


@pytest.fixture(scope="module")
def pair():
    return [np.ascontiguousarray(picture[:200, :300]) for picture in stereo_pair()]


@pytest.fixture
def folder(tmp_path, pair):
    (tmp_path / "photos").mkdir()
    write_photograph(tmp_path / "photos/b.png", pair[1], 6)
    write_photograph(tmp_path / "photos/a.png", pair[0], 8)
    return tmp_path / "photos"


def test_folder_of_turned_photographs_is_a_scene_of_upright_ones(folder, pair, find_calls):
    scene = datasets.load("photographs", folder)
    assert scene.name == "photos" and list(scene.cameras) == ["a.png", "b.png"]
    for name, picture in zip(scene.cameras, pair, strict=True):
        np.testing.assert_array_equal(scene.read(name).image, picture)
    assert scene.estimation["confidence"] == 0.75 and scene.estimation["pairs"][0]["angle"] is None
    sample = scene.sample(["a", "b"], size=(100, 150))
    assert (
        sample.estimation == scene.estimation
        and sample.resize(50, 75).estimation == scene.estimation
    )
    for view in sample.context:
        assert view.camera.estimated == Estimated((0.9, 1.1), "guess", 0.75)
    files, _ = datasets.inputs("photographs", folder, ["a.png"])
    assert files == [folder / "a.png", folder / "b.png"]
    # Cameras are estimated once per photographs and order, and anew when either changes.
    datasets.load("photographs", [folder / "a.png", folder / "b.png"])
    assert find_calls == [["a.png", "b.png"]]
    datasets.load("photographs", [folder / "b.png", folder / "a.png"])
    assert find_calls[1:] == [["b.png", "a.png"]]
    shutil.copy(folder / "a.png", folder / "b.png")
    datasets.load("photographs", folder)
    assert len(find_calls) == 3


def test_option_only_selects_photographs_of_a_folder(folder, find_calls):
    shutil.copy(folder / "a.png", folder / "c.png")
    only = ["b.png", "a.png"]
    scene = datasets.load("photographs", folder, only=only)
    assert find_calls == [only] and list(scene.cameras) == only
    named, _ = datasets.inputs("photographs", folder, ["b.png"], only=only)
    assert named == [folder / "b.png", folder / "a.png"]
    with pytest.raises(InputError, match=r"d\.png"):
        datasets.load("photographs", folder, only=["a.png", "d.png"])


@pytest.mark.usefixtures("find_calls")
def test_python_function_keeps_order_and_tells_equal_names_apart(folder):
    sample = slg.photographs(folder / "b.png", folder / "a.png", near=0.5, far=9.0)
    assert [view.name for view in sample.context] == ["b.png", "a.png"]
    assert (sample.context[0].camera.near, sample.context[0].camera.far) == (0.5, 9.0)
    second_folder = shutil.copytree(folder, folder.parent / "other")
    sample = slg.photographs(folder / "a.png", second_folder / "b.png")
    assert [view.name for view in sample.context] == ["photos/a.png", "other/b.png"]


@pytest.mark.usefixtures("find_calls")
def test_images_in_memory_equal_those_of_files(tmp_path, pair):
    files = [write_photograph(tmp_path / f"{n}.jpg", p, 6) for n, p in zip("ab", pair, strict=True)]
    stored = slg.photographs(files, size="original").context
    for images in ([Image.open(file) for file in files], [view.image for view in stored]):
        views = slg.photographs(*images, size="original").context
        assert [view.name for view in views] == ["image_0", "image_1"]
        for view, expected in zip(views, stored, strict=True):
            np.testing.assert_array_equal(view.image, expected.image)
            np.testing.assert_array_equal(view.camera.K, expected.camera.K)
    for images, message in [
        ((pair[0], "b.jpg"), "image 1 is a str; expected paths alone"),
        ((pair[0] / 255, pair[1]), "image 0 is a ndarray of float64"),
        ((pair[0],), "found 1 image, expected at least two"),
    ]:
        with pytest.raises(InputError, match=message):
            slg.photographs(*images)


@pytest.mark.parametrize(
    ("files", "refusal"),
    [
        (["a.png"], r"found .*a\.png, expected at least two"),
        ([], "found nothing, expected at least two"),
        (["a.png", "b.png", "../photos/a.png"], "given twice"),
        (["a.png", "gone.jpg"], r"gone\.jpg: cannot be read \(No such file"),
        (["a.png", "text.jpg"], r"text\.jpg: cannot be read"),
        (["empty", "a.png"], "empty: holds no photographs"),
    ],
)
@pytest.mark.usefixtures("find_calls")
def test_photographs_error_names_unusable_file(folder, files, refusal):
    (folder / "text.jpg").write_text("no picture")
    (folder / "empty").mkdir()
    with pytest.raises(InputError, match=refusal):
        slg.photographs(*(folder / file for file in files))


def test_cameras_of_a_stereo_pair_are_estimated(tmp_path):
    pair = zip(("a.jpg", "b.jpg"), stereo_pair(), strict=True)
    files = [write_photograph(tmp_path / name, pixels, 6) for name, pixels in pair]
    sample = slg.photographs(*files, size=(120, 176))
    first, second = (view.camera for view in sample.context)
    np.testing.assert_allclose(first.c2w, np.eye(4), atol=1e-9)
    assert np.linalg.norm(second.center) == pytest.approx(1)
    assert second.center[0] > 0.9  # to the right, as the second photograph was taken
    assert first.estimated is not None and sample.estimation["focals"].keys() == {"a.jpg", "b.jpg"}
