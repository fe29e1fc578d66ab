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

LENSES = {
    "SIMPLE_RADIAL": (150.0, 121.4, 104.7, -0.12),
    "RADIAL": (150.0, 121.4, 104.7, -0.15, 0.03),
    "OPENCV": (160.0, 163.0, 121.4, 104.7, -0.2, 0.05, 0.004, -0.006),
    "FULL_OPENCV": (160.0, 163.0, 121.4, 104.7, -0.2, 0.05, 0.004, -0.006, 0.01, 0.02, 0.01, 0.0),
    "OPENCV_FISHEYE": (160.0, 163.0, 121.4, 104.7, 0.05, -0.02, 0.004, -0.001),
    "SIMPLE_FISHEYE": (150.0, 121.4, 104.7),
    "FISHEYE": (150.0, 153.0, 121.4, 104.7),
    "SIMPLE_RADIAL_FISHEYE": (150.0, 121.4, 104.7, 0.04),
    "RADIAL_FISHEYE": (150.0, 121.4, 104.7, 0.04, -0.01),
}


@pytest.fixture
def scene(tmp_path):
    write_model(tmp_path / "sparse/0", SHOTS, CAMERAS, POINTS)
    write_pictures(tmp_path / "images", list(SHOTS))
    return tmp_path


@pytest.mark.parametrize(
    ("place", "text"),
    [("sparse/0", False), ("sparse", True), ("colmap/sparse/0", False), (".", True)],
)
def test_cameras_are_those_that_pycolmap_reads(tmp_path, place, text):
    write_model(tmp_path / place, SHOTS, CAMERAS, POINTS, text)
    theirs = pytest.importorskip("pycolmap").Reconstruction(tmp_path / place)
    cameras = colmap.read(tmp_path).cameras
    assert list(cameras) == ["a.png", "b.png", "deep/a.png"]  # whatever the ids
    for image in theirs.images.values():
        own = cameras[image.name]
        # 17 digits in text and 8 bytes in binary files leave no more than this.
        assert own.w2c[:3] == pytest.approx(image.cam_from_world().matrix(), abs=1e-14)
        assert pytest.approx(image.camera.calibration_matrix()) == own.K


def test_text_files_need_no_lines_of_points(tmp_path):
    # As written from known poses, and with points below some images only.
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
    def several(self, tmp_path):
        names = [f"{k:02}.png" for k in range(12)]
        write_pictures(tmp_path / "images", names)
        shots = [Shot(k + 1, place=(k, 0, 0)) for k in range(12)]
        for number, part in (("0", slice(2)), ("1", slice(2, 12)), ("10", slice(1))):
            some = dict(zip(names[part], shots[part], strict=True))
            write_model(tmp_path / "sparse" / number, some, text=number == "1")
        return tmp_path

    @pytest.mark.parametrize("place", [".", "sparse"])
    def test_the_largest_is_taken_and_that_is_said(self, several, place):
        with pytest.warns(UserWarning, match=r"\(2 in 0, 10 in 1, 1 in 10 images\), of which 1 is"):
            scene, _ = posed_scene(several / place)
        assert len(scene.cameras) == 10 and scene.name == several.name
        assert (scene.read("05.png").image == picture(5)).all()

    @pytest.mark.parametrize("place", ["sparse/0", "sparse/0/images.bin"])
    def test_another_one_may_be_given(self, several, place):
        scene, folder = posed_scene(several / place)
        assert list(scene.cameras) == ["00.png", "01.png"] and folder == several / "images"
        assert (scene.read("01.png").image == picture(1)).all()


def test_beyond_the_fold_of_a_polynomial_there_is_nothing(tmp_path):
    # Beyond r = 1 / sqrt(3 * 0.9) of the image plane this lens turns back towards the middle.
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
def test_lenses_that_opencv_does_not_have_are_refused(tmp_path, model, params):
    write_model(tmp_path / "sparse/0", {"a.png": Shot(1)}, {1: (model, params)})
    with pytest.raises(InputError, match=r"camera 1 is of model \w+, expected one"):
        colmap.read(tmp_path)


def test_photographs_are_found_below_folders_and_shrunk_ones_get_shrunk_cameras(scene):
    read = colmap.read(scene)
    assert (read.read("deep/a.png").image == picture(2)).all()
    assert read.find("b") == "b.png"
    with pytest.raises(InputError, match="is ambiguous"):
        read.find("a")
    shutil.rmtree(scene / "images")
    for factor in (2, 4):
        write_pictures(scene / f"images_{factor}", list(SHOTS), WIDTH // factor, HEIGHT // factor)
    half, quarter = colmap.read(scene), colmap.read(scene, images="images_4")
    for read, factor in ((half, 2), (quarter, 4)):
        camera = read.read("a.png").camera
        assert (camera.width, camera.height) == (WIDTH // factor, HEIGHT // factor)
        assert np.allclose(camera.K[:2] * factor, [[80, 0, 47.3], [0, 82, 33.1]])


@pytest.mark.parametrize("kind", ["cameras", "images"])
def test_a_damaged_binary_file_is_named(scene, kind):
    file = scene / f"sparse/0/{kind}.bin"
    data = file.read_bytes()
    for end in range(0, len(data), max(1, len(data) // 60)):
        file.write_bytes(data[:end])
        with pytest.raises(InputError, match=rf"{kind}\.bin: .*damaged or cut short"):
            colmap.read(scene)
    file.write_bytes(data + b"\0")
    with pytest.raises(InputError, match=rf"{kind}\.bin: .*its last entry ends at byte"):
        colmap.read(scene)
    file.write_bytes(struct.pack("<Q", 2**61) + bytes(100))  # takes no memory
    with pytest.raises(InputError, match=rf"{kind}\.bin: is damaged"):
        colmap.read(scene)


@pytest.mark.parametrize(
    ("kind", "old", "new", "sentence"),
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
def test_what_cannot_be_is_said(tmp_path, kind, old, new, sentence):
    write_model(tmp_path / "sparse/0", SHOTS, CAMERAS, POINTS, text=True)
    file = tmp_path / f"sparse/0/{kind}.txt"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(InputError) as caught:
        colmap.read(tmp_path)
    assert sentence in str(caught.value) and str(tmp_path / "sparse/0") in str(caught.value)


def test_no_model_and_no_pose_are_said(tmp_path):
    with pytest.raises(InputError, match="has no COLMAP model; expected cameras and images"):
        load("colmap", tmp_path)
    write_model(tmp_path / "sparse/0", {}, CAMERAS)
    with pytest.raises(InputError, match="has no posed image"):
        load("colmap", tmp_path)
