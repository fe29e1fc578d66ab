"""Cameras of every format that holds files are known, and anything else is named."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from flows.cli.photographs import find_views
from slgaussian import datasets
from slgaussian.datasets.photographs import open_photograph, stored_size
from slgaussian.datasets.recognise import cameras_in, posed_scene, recognise
from slgaussian.errors import InputError
from tests.flows.command import write_photographs

NAMES = ("a.png", "b.png")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two photographs and their cameras in three formats, each in a folder of its own."""
    room = datasets.load("procedural", views=2, height=48, width=64)
    views = [room.read(name) for name in room.cameras]
    photographs = {f"images/{name}": view for name, view in zip(NAMES, views, strict=True)}
    for kind in ("nerf", "llff", "colmap"):
        write_photographs(tmp_path / kind, photographs)
    for kind in ("llff", "colmap"):
        (tmp_path / kind / "transforms.json").unlink()
    focal = float(views[0].camera.K[0, 0])
    rows = []
    for view in views:
        right, down, forward, center = view.camera.c2w[:3].T
        matrix = np.stack([down, right, -forward, center, [48, 64, focal]], 1)
        rows.append([*matrix.ravel(), 1.0, 9.0])
    np.save(tmp_path / "llff/poses_bounds.npy", rows)
    model = tmp_path / "colmap/sparse/0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text(f"1 PINHOLE 64 48 {focal} {focal} 32 24\n")
    lines = []
    for number, (name, view) in enumerate(zip(NAMES, views, strict=True), 1):
        turn = np.roll(Rotation.from_matrix(view.camera.w2c[:3, :3]).as_quat(), 1)
        lines.append(" ".join(map(str, [number, *turn, *view.camera.w2c[:3, 3], 1, name])))
    (model / "images.txt").write_text("\n".join(lines))
    return tmp_path


@pytest.mark.parametrize(
    "given",
    ["nerf", "nerf/transforms.json", "llff", "llff/poses_bounds.npy", "colmap", "colmap/sparse"]
    + ["colmap/sparse/0", "colmap/sparse/0/images.txt"],
)
def test_every_format_gives_the_same_sample(folder, given):
    kind = given.split("/")[0]
    photographs = [str(folder / kind / "images" / name) for name in NAMES]
    scene, start = posed_scene(folder / given, photographs)
    files = {(start / name).resolve(): name for name in scene.cameras}
    sample = scene.sample([files[Path(p).resolve()] for p in photographs])
    room = datasets.load("procedural", views=2, height=48, width=64)
    for view, name in zip(sample.context, room.cameras, strict=True):
        true = room.read(name)
        np.testing.assert_array_equal(view.image, true.image)
        np.testing.assert_allclose(view.camera.c2w, true.camera.c2w, atol=1e-9)
        np.testing.assert_allclose(view.camera.K, true.camera.K, atol=1e-9)
    assert len(cameras_in(folder / given)) == 2


@pytest.mark.parametrize("kind", ["nerf", "llff/poses_bounds.npy", "colmap/sparse/0"])
def test_a_folder_stands_for_its_photographs_that_have_a_camera(folder, kind):
    root = folder / kind.split("/")[0]
    for place in (root, root / "images"):
        scene, start = posed_scene(folder / kind, [str(place)])
        views = find_views(scene, [str(place)], start)
        assert [Path(name).name for name, _ in views] == list(NAMES)
        assert [file.resolve() for _, file in views] == [root / "images" / n for n in NAMES]
    (folder / "empty").mkdir()
    with pytest.raises(InputError, match=r"empty: none of the 2 photographs that have a camera"):
        find_views(scene, [str(folder / "empty")], start)


def test_photographs_of_a_model_may_be_elsewhere_in_several_folders(folder):
    images, elsewhere = folder / "colmap/sparse/0/images.txt", folder / "elsewhere"
    images.write_text(images.read_text().replace("a.png", "x/a.png").replace("b.png", "y/b.png"))
    for name in ("x/a.png", "y/b.png"):
        (elsewhere / name).parent.mkdir(parents=True)
        (folder / "nerf/images" / Path(name).name).rename(elsewhere / name)
    (folder / "colmap/images").rename(folder / "unused")
    scene, start = posed_scene(
        folder / "colmap", [str(elsewhere / "x/a.png"), str(elsewhere / "y")]
    )
    assert start == elsewhere
    assert [scene.read(name).name for name in scene.cameras] == ["x/a.png", "y/b.png"]


def test_photographs_of_a_model_may_be_elsewhere_in_one_folder_below_its_own(folder):
    images, elsewhere = folder / "colmap/sparse/0/images.txt", folder / "elsewhere"
    images.write_text(images.read_text().replace("a.png", "x/a.png").replace("b.png", "x/b.jpg"))
    elsewhere.mkdir()
    (folder / "colmap/images").rename(elsewhere / "x")
    scene, start = posed_scene(folder / "colmap", [str(elsewhere / "x/b.png")])
    assert start == elsewhere
    assert [scene.read(name).name for name in scene.cameras] == ["x/a.png", "x/b.jpg"]
    shutil.copytree(elsewhere / "x", elsewhere / "x/x")  # the nearest folder that fits is taken
    files = [str(elsewhere / place / "b.png") for place in ("x", "x/x")]
    assert posed_scene(folder / "colmap", files)[1] == elsewhere / "x"


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda p: None, "No such file"),
        (lambda p: p.mkdir(), "holds no cameras but nothing"),
        (lambda p: (p.mkdir(), (p / "t.json").write_text("{}")), "holds no cameras but t.json"),
        (lambda p: p.write_text("hello"), "is no file of cameras"),
    ],
    ids=["nothing", "empty", "json", "text"],
)
def test_anything_else_is_one_clear_sentence(tmp_path, make, said):
    make(tmp_path / "x")
    with pytest.raises(InputError, match=r"expected transforms\.json") as refused:
        recognise(tmp_path / "x")
    assert said in str(refused.value) and str(tmp_path / "x") in str(refused.value)


def test_a_turned_photograph_is_read_as_its_camera_saw_it(tmp_path):
    stored = np.zeros((40, 60, 3), np.uint8)
    stored[:20, :30] = 255  # bright at the top left as stored
    exif = Image.Exif()
    exif[0x0112] = 6  # to be turned clockwise
    file = tmp_path / "a.png"
    Image.fromarray(stored).save(file, exif=exif)
    np.testing.assert_array_equal(open_photograph(file, (60, 40))[0], stored)
    np.testing.assert_array_equal(open_photograph(file)[0], stored)
    upright = np.rot90(stored, -1)
    np.testing.assert_array_equal(open_photograph(file, (40, 60))[0], upright)
    assert stored_size(file, (80, 120)) == (40, 60) and stored_size(file) == (60, 40)
    Image.fromarray(stored).save(file)  # without the tag nothing is guessed
    np.testing.assert_array_equal(open_photograph(file, (40, 60))[0], stored)
