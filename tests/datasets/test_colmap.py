"""COLMAP models, text and binary, against pycolmap; photographs beside them; damaged models."""

import shutil
import struct

import numpy as np
import pytest
from PIL import Image
from posed_folders import HEIGHT, PINHOLE, WIDTH, Shot, picture, write_model, write_pictures

from slgaussian.datasets import colmap, load
from slgaussian.datasets.recognise import posed_scene
from slgaussian.errors import InputError

SHOTS = {
    "b.png": Shot(3, place=(0.1, 0.2, -0.3), turn=20),
    "a.png": Shot(11, place=(1, 0, 0), turn=-35),
    "deep/a.png": Shot(2, camera=2, place=(0, 0.5, 0)),
}
CAMERAS = {1: PINHOLE, 2: ("SIMPLE_PINHOLE", (75.0, 40.0, 30.0))}
POINTS = np.random.default_rng(0).uniform((-1, -1, 3), (1, 1, 6), (40, 3))


@pytest.fixture
def root(tmp_path):
    write_model(tmp_path / "sparse/0", SHOTS, CAMERAS, POINTS)
    write_pictures(tmp_path / "images", list(SHOTS))
    return tmp_path


@pytest.mark.parametrize(
    ("folder", "text"),
    [("sparse/0", False), ("sparse", True), ("colmap/sparse/0", False), (".", True)],
)
def test_cameras_equal_those_of_pycolmap(tmp_path, folder, text):
    write_model(tmp_path / folder, SHOTS, CAMERAS, POINTS, text)
    reference = pytest.importorskip("pycolmap").Reconstruction(tmp_path / folder)
    cameras = colmap.read(tmp_path).cameras
    assert list(cameras) == ["a.png", "b.png", "deep/a.png"]  # by name, not by id
    for image in reference.images.values():
        camera = cameras[image.name]
        # 17 digits in text and 8 bytes in binary files leave no more than this.
        assert camera.w2c[:3] == pytest.approx(image.cam_from_world().matrix(), abs=1e-14)
        assert pytest.approx(image.camera.calibration_matrix()) == camera.K


def test_text_model_may_lack_lines_of_points(tmp_path):
    # Converters of known poses write none; others only below some images.
    write_model(tmp_path / "sparse/0", SHOTS, CAMERAS, POINTS[:2], text=True)
    file = tmp_path / "sparse/0/images.txt"
    poses = [line for line in file.read_text().splitlines() if line.endswith(".png")]
    points = "0.5 1 7 20 1e1 -1"
    for lines in (
        poses, [poses[0], points, *poses[1:]], [*poses, points], [*poses[:2], "", poses[2]],
    ):  # fmt: skip
        file.write_text("\n".join(lines))
        cameras = colmap.read(tmp_path).cameras
        assert len(cameras) == 3
        for name, camera in cameras.items():
            assert camera.w2c[:3] == pytest.approx(SHOTS[name].w2c(), abs=1e-12)


class TestSeveralModels:
    @pytest.fixture
    def root(self, tmp_path):
        names = [f"{k:02}.png" for k in range(12)]
        write_pictures(tmp_path / "images", names)
        shots = [Shot(k + 1, place=(k, 0, 0)) for k in range(12)]
        for number, part in (("0", slice(2)), ("1", slice(2, 12)), ("10", slice(1))):
            model = dict(zip(names[part], shots[part], strict=True))
            write_model(tmp_path / "sparse" / number, model, text=number == "1")
        return tmp_path

    @pytest.mark.parametrize("path", [".", "sparse"])
    def test_largest_is_read_with_a_warning(self, root, path):
        with pytest.warns(UserWarning, match=r"\(2 in 0, 10 in 1, 1 in 10 images\), of which 1 is"):
            scene, _ = posed_scene(root / path)
        assert len(scene.cameras) == 10 and scene.name == root.name
        assert (scene.read("05.png").image == picture(5)).all()

    @pytest.mark.parametrize("path", ["sparse/0", "sparse/0/images.bin"])
    def test_path_selects_a_smaller_model(self, root, path):
        scene, folder = posed_scene(root / path)
        assert list(scene.cameras) == ["00.png", "01.png"] and folder == root / "images"
        assert (scene.read("01.png").image == picture(1)).all()


def test_image_is_black_beyond_the_fold_of_a_radial_polynomial(tmp_path):
    # At r = 1 / sqrt(3 * 0.9) of the image plane, distorted radii begin to decrease.
    lens = {1: ("SIMPLE_RADIAL", (60.0, 48.0, 32.0, -0.9))}
    write_model(tmp_path / "sparse/0", {"a.png": Shot(1)}, lens)
    (tmp_path / "images").mkdir()
    Image.new("RGB", (WIDTH, HEIGHT), "white").save(tmp_path / "images/a.png")
    image = colmap.read(tmp_path).read("a.png").image
    rows, cols = np.indices((HEIGHT, WIDTH)) + 0.5
    radius = np.hypot(cols - 48, rows - 32) / 60
    fold = 1 / np.sqrt(2.7)
    assert (image[radius < fold - 0.03] == 255).all()
    assert (image[radius > fold + 0.03] == 0).all()


@pytest.mark.parametrize(
    ("model", "params"), [("EQUIRECTANGULAR", (WIDTH, HEIGHT)), ("FOV", (80, 80, 48, 32, 0.6))]
)
def test_read_refuses_camera_models_without_opencv_counterpart(tmp_path, model, params):
    write_model(tmp_path / "sparse/0", {"a.png": Shot(1)}, {1: (model, params)})
    with pytest.raises(InputError, match=r"camera 1 is of model \w+, expected one"):
        colmap.read(tmp_path)


def test_photographs_are_read_by_name_and_shrunk_ones_scale_their_cameras(root):
    scene = colmap.read(root)
    assert (scene.read("deep/a.png").image == picture(2)).all()
    assert scene.find("b") == "b.png"
    with pytest.raises(InputError, match="is ambiguous"):
        scene.find("a")
    shutil.rmtree(root / "images")
    for factor in (2, 4):
        write_pictures(root / f"images_{factor}", list(SHOTS), WIDTH // factor, HEIGHT // factor)
    for scene, factor in ((colmap.read(root), 2), (colmap.read(root, images="images_4"), 4)):
        camera = scene.read("a.png").camera
        assert (camera.width, camera.height) == (WIDTH // factor, HEIGHT // factor)
        assert np.allclose(camera.K[:2] * factor, [[80, 0, 47.3], [0, 82, 33.1]])


@pytest.mark.parametrize("kind", ["cameras", "images"])
def test_read_error_names_damaged_binary_file(root, kind):
    file = root / f"sparse/0/{kind}.bin"
    data = file.read_bytes()
    ends = range(0, len(data), max(1, len(data) // 60))
    damaged = [(data[:end], ".*damaged or cut short") for end in ends]
    damaged.append((data + b"\0", ".*its last entry ends at byte"))
    damaged.append((struct.pack("<Q", 2**61) + bytes(100), "is damaged"))  # allocates no memory
    for content, refusal in damaged:
        file.write_bytes(content)
        with pytest.raises(InputError, match=rf"{kind}\.bin: {refusal}"):
            colmap.read(root)


@pytest.mark.parametrize(
    ("kind", "old", "new", "refusal"),
    [
        ("cameras", "2 SIMPLE_PINHOLE", "2 MAGIC", "is of model MAGIC"),
        ("cameras", "2 SIMPLE_PINHOLE", "2 OPENCV", "camera 2: OPENCV with parameters"),
        ("cameras", "2 SIMPLE_PINHOLE", "1 SIMPLE_PINHOLE", "it has two cameras 1"),
        ("cameras", "75", "0.8", "focal length x is 0.8, for 96x64 pixels a field"),
        ("cameras", "2 SIMPLE_PINHOLE", "7 SIMPLE_PINHOLE", "taken with camera 2"),
        ("images", " deep/a.png", " b.png", "two images are called 'b.png'"),
        ("images", "2 1 0 -0 0", "2 1 0", "is damaged"),
        ("images", "2 1 0 -0 0", "2 1 1 0 0", "is no unit quaternion"),
    ],
)
def test_read_refuses_inconsistent_text_model(tmp_path, kind, old, new, refusal):
    write_model(tmp_path / "sparse/0", SHOTS, CAMERAS, POINTS, text=True)
    file = tmp_path / f"sparse/0/{kind}.txt"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(InputError) as error:
        colmap.read(tmp_path)
    assert refusal in str(error.value) and str(tmp_path / "sparse/0") in str(error.value)


def test_read_refuses_folder_without_model_or_pose(tmp_path):
    with pytest.raises(InputError, match="has no COLMAP model; expected cameras and images"):
        load("colmap", tmp_path)
    write_model(tmp_path / "sparse/0", {}, CAMERAS)
    with pytest.raises(InputError, match="has no posed image"):
        load("colmap", tmp_path)
