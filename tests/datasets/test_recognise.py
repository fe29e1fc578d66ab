"""Recognition of camera formats by their files, and of the photographs that belong to them."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image
from scipy.spatial.transform import Rotation

from flows.cli.photographs import find_views
from slgaussian import datasets
from slgaussian.datasets.photographs import open_photograph, stored_size
from slgaussian.datasets.recognise import cameras_in, posed_scene, recognise
from slgaussian.errors import InputError
from slgaussian.scene import View
from tests.flows.command import write_photographs

NAMES = ("a.png", "b.png")


@pytest.fixture
def views() -> list[View]:
    room = datasets.load("procedural", views=2, height=48, width=64)
    return [room.read(name) for name in room.cameras]


@pytest.fixture
def folder(tmp_path: Path, views: list[View]) -> Path:
    """Two photographs and their cameras in three formats, each in a folder of its own."""
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
    "path",
    ["nerf", "nerf/transforms.json", "llff", "llff/poses_bounds.npy", "colmap", "colmap/sparse"]
    + ["colmap/sparse/0", "colmap/sparse/0/images.txt"],
)
def test_every_format_gives_the_same_sample(folder, views, path):
    photographs = [str(folder / path.split("/")[0] / "images" / name) for name in NAMES]
    scene, start = posed_scene(folder / path, photographs)
    files = {(start / name).resolve(): name for name in scene.cameras}
    sample = scene.sample([files[Path(p).resolve()] for p in photographs])
    for view, expected in zip(sample.context, views, strict=True):
        np.testing.assert_array_equal(view.image, expected.image)
        np.testing.assert_allclose(view.camera.c2w, expected.camera.c2w, atol=1e-9)
        np.testing.assert_allclose(view.camera.K, expected.camera.K, atol=1e-9)
    assert len(cameras_in(folder / path)) == 2


@pytest.mark.parametrize("path", ["nerf", "llff/poses_bounds.npy", "colmap/sparse/0"])
def test_folder_selects_its_photographs_that_have_a_camera(folder, path):
    root = folder / path.split("/")[0]
    for selected in (root, root / "images"):
        scene, start = posed_scene(folder / path, [str(selected)])
        views = find_views(scene, [str(selected)], start)
        assert [Path(name).name for name, _ in views] == list(NAMES)
        assert [file.resolve() for _, file in views] == [root / "images" / n for n in NAMES]
    (folder / "empty").mkdir()
    with pytest.raises(InputError, match=r"empty: none of the 2 photographs that have a camera"):
        find_views(scene, [str(folder / "empty")], start)


@pytest.mark.parametrize(
    ("names", "paths"),
    [(["x/a.png", "y/b.png"], ["x/a.png", "y"]), (["x/a.png", "x/b.jpg"], ["x/b.png"])],
    ids=["two subfolders", "one subfolder"],
)
def test_photographs_of_a_model_may_lie_in_another_folder(folder, names, paths):
    model, elsewhere = folder / "colmap/sparse/0/images.txt", folder / "elsewhere"
    text = model.read_text()
    for name, stored in zip(NAMES, names, strict=True):
        text = text.replace(name, stored)
        file = (elsewhere / stored).with_name(name)
        file.parent.mkdir(parents=True, exist_ok=True)
        (folder / "colmap/images" / name).rename(file)
    (folder / "colmap/images").rmdir()
    model.write_text(text)
    scene, start = posed_scene(folder / "colmap", [str(elsewhere / path) for path in paths])
    assert start == elsewhere
    assert [scene.read(name).name for name in scene.cameras] == names
    if len(paths) == 1:
        shutil.copytree(elsewhere / "x", elsewhere / "x/x")  # The nearest folder that fits wins.
        files = [str(elsewhere / subfolder / "b.png") for subfolder in ("x", "x/x")]
        assert posed_scene(folder / "colmap", files)[1] == elsewhere / "x"


@pytest.mark.parametrize(
    ("make", "refusal"),
    [
        (lambda p: None, "No such file"),
        (lambda p: p.mkdir(), "holds no cameras but nothing"),
        (lambda p: (p.mkdir(), (p / "t.json").write_text("{}")), "holds no cameras but t.json"),
        (lambda p: p.write_text("hello"), "is no file of cameras"),
    ],
    ids=["nothing", "empty", "json", "text"],
)
def test_recognise_refuses_path_without_cameras(tmp_path, make, refusal):
    make(tmp_path / "x")
    with pytest.raises(InputError, match=r"expected transforms\.json") as error:
        recognise(tmp_path / "x")
    assert refusal in str(error.value) and str(tmp_path / "x") in str(error.value)


def test_turned_photograph_is_read_in_the_orientation_of_its_camera(tmp_path):
    stored = np.zeros((40, 60, 3), np.uint8)
    stored[:20, :30] = 255
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6  # stored turned left by 90 degrees
    file = tmp_path / "a.png"
    Image.fromarray(stored).save(file, exif=exif)
    np.testing.assert_array_equal(open_photograph(file, (60, 40))[0], stored)
    np.testing.assert_array_equal(open_photograph(file)[0], stored)
    upright = np.rot90(stored, -1)
    np.testing.assert_array_equal(open_photograph(file, (40, 60))[0], upright)
    assert stored_size(file, (80, 120)) == (40, 60) and stored_size(file) == (60, 40)
    Image.fromarray(stored).save(file)  # Without the tag, pixels stay as stored.
    np.testing.assert_array_equal(open_photograph(file, (40, 60))[0], stored)
