"""Known 3D points through every reader and lens: drawn as dots, then measured in the image read.

pycolmap's lens places the dots, so that in the undistorted image each is a Gaussian about the
float64 projection of its point.
"""

import codecs
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from posed_folders import write_model
from scipy.spatial.transform import Rotation

from slgaussian.datasets import load, re10k
from slgaussian.scene import Scene

WIDTH, HEIGHT = 250, 200
SIGMA, HALF = 3.0, 13
MIDDLE = (WIDTH / 2, HEIGHT / 2)
NAMES = ("a.png", "b.png")
POINTS = np.array(
    [(0.1, 0, 4), (-1.2, -0.9, 4.2), (1.4, -0.8, 3.8), (-1.1, 0.9, 4.1), (1.3, 1, 4.4)]
)


@dataclass(frozen=True)
class Pose:
    """An image's id, rotation about all axes and position, as :func:`write_model` takes it."""

    number: int
    turn: tuple[float, float, float]
    place: tuple[float, float, float]
    camera: int = 1

    def w2c(self) -> np.ndarray:
        R = Rotation.from_euler("xyz", self.turn, degrees=True).as_matrix()
        return np.column_stack([R, -R @ self.place])


POSES = (Pose(1, (4, -3, 20), (0.1, -0.2, 0.3)), Pose(2, (-5, 6, -11), (0.4, 0.1, -0.2)))


def transforms(folder, top=None, frame=None, encode=str.encode, name="images/{}") -> Scene:
    """Write transforms.json with keys at the top and in each frame, and read it."""
    frames = []
    for n, pose in zip(NAMES, POSES, strict=True):
        c2w = np.linalg.inv(np.vstack([pose.w2c(), (0, 0, 0, 1)]))
        opengl = (c2w @ np.diag([1.0, -1, -1, 1])).tolist()
        frames.append({"file_path": name.format(n), "transform_matrix": opengl, **(frame or {})})
    content = {"w": WIDTH, "h": HEIGHT, **(top or {}), "frames": frames}
    (folder / "transforms.json").write_bytes(encode(json.dumps(content)))
    return load("nerfstudio", folder)


def intrinsics(fx, fy, cx=121.4, cy=104.7, **keys) -> dict:
    return {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, **keys}


def angle(focal: float, size: int) -> float:
    return 2 * np.arctan(size / 2 / focal)


def encode_with_bom(text: str) -> bytes:
    return codecs.BOM_UTF8 + text.encode()


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
PINHOLE = "PINHOLE", (150, 153, 121.4, 104.7)
FISHEYE = "OPENCV_FISHEYE", LENSES["OPENCV_FISHEYE"]
NERFSTUDIO = {  # keys of a file, and pycolmap's model and parameters of the same lens
    "pinhole": ({"top": intrinsics(150, 153)}, *PINHOLE),
    "opencv": (
        {"top": intrinsics(160, 163, k1=-0.2, k2=0.05, p1=0.004, p2=-0.006, k3=0.01)},
        *("FULL_OPENCV", (160, 163, 121.4, 104.7, -0.2, 0.05, 0.004, -0.006, 0.01, 0, 0, 0)),
    ),
    "fisheye": (
        {
            "top": intrinsics(160, 163, k1=0.05, k2=-0.02, k3=0.004, k4=-0.001),
            "frame": {"camera_model": "OPENCV_FISHEYE"},
        },
        *FISHEYE,
    ),
    "is_fisheye": (
        {"top": intrinsics(160, 163, k1=0.05, k2=-0.02, k3=0.004, k4=-0.001, is_fisheye=True)},
        *FISHEYE,
    ),
    "radians": (
        {"top": {"camera_angle_x": angle(150, WIDTH), "camera_angle_y": angle(130, HEIGHT)}},
        *("PINHOLE", (150, 130, *MIDDLE)),
    ),
    "degrees": (
        {"top": {"x_fov": np.degrees(angle(150, WIDTH)), "y_fov": np.degrees(angle(130, HEIGHT))}},
        *("PINHOLE", (150, 130, *MIDDLE)),
    ),
    "a frame's angle": (
        {"top": {"fl_x": 300.0}, "frame": {"camera_angle_x": angle(150, WIDTH)}},
        *("PINHOLE", (150, 150, *MIDDLE)),
    ),
    "neutral keys": (
        {
            "top": intrinsics(
                *(150, 153), is_fisheye=False, k5=0, ortho=False, rolling_shutter=[0, 0, 0],
                applied_transform=np.eye(4)[:3].tolist(), aabb_scale=16, scale=0.3, scale_factor=1,
                distortion_model="none",
            )
        },
        *PINHOLE,
    ),
    "written on Windows": (
        {"top": intrinsics(150, 153), "encode": encode_with_bom, "name": "images\\{}"}, *PINHOLE,
    ),
}  # fmt: skip


def read_llff(folder: Path) -> Scene:
    rows = []
    for pose in POSES:
        right, down, forward = pose.w2c()[:, :3]
        matrix = np.column_stack([down, right, -forward, pose.place, (HEIGHT, WIDTH, 150)])
        rows.append([*matrix.ravel(), 1, 9])
    np.save(folder / "poses_bounds.npy", rows)
    return load("llff", folder)


def read_re10k(folder: Path) -> Scene:
    fractions = (150 / WIDTH, 153 / HEIGHT, 121.4 / WIDTH, 104.7 / HEIGHT)
    rows = np.array([[*fractions, 0, 0, *pose.w2c().ravel()] for pose in POSES], np.float32)
    images = tuple((folder / "images" / name).read_bytes() for name in NAMES)
    re10k.write(folder / "test", [re10k.Clip("clip", "", np.arange(2), rows, images)])
    return load("re10k", folder / "test", "clip")


def read_colmap(model, params, text):
    def read(folder: Path) -> Scene:
        shots = dict(zip(NAMES, POSES, strict=True))
        write_model(
            folder / "sparse/0", shots, {1: (model, params)}, text=text, size=(WIDTH, HEIGHT)
        )
        if text:  # as converters of known poses write it on Windows
            images = folder / "sparse/0/images.txt"
            lines = [line for line in images.read_text().splitlines() if line.strip()]
            images.write_bytes(encode_with_bom("\r\n".join(lines)))
        return load("colmap", folder)

    return read


READERS = {
    "llff": (read_llff, "SIMPLE_PINHOLE", (150, *MIDDLE)),
    "re10k": (read_re10k, *PINHOLE),
    **{
        f"nerfstudio {name}": (lambda folder, keys=keys: transforms(folder, **keys), *lens)
        for name, (keys, *lens) in NERFSTUDIO.items()
    },
    **{
        f"colmap {model}{' text' * text}": (read_colmap(model, params, text), model, params)
        for model, params in {
            **LENSES, **dict([PINHOLE]), "SIMPLE_PINHOLE": (150, 121.4, 104.7)
        }.items()
        for text in ((False, True) if model == "OPENCV" else (False,))
    },
}  # fmt: skip


@pytest.mark.parametrize("reader", READERS)
def test_dots_lie_at_the_projections_of_their_points(tmp_path, reader):
    pycolmap = pytest.importorskip("pycolmap")
    read, model, params = READERS[reader]
    lens = pycolmap.Camera(model=model, width=WIDTH, height=HEIGHT, params=list(params))
    K = lens.calibration_matrix()
    v, u = np.indices((HEIGHT, WIDTH)) + 0.5
    rays = lens.cam_from_img(np.stack([u, v], -1).reshape(-1, 2))
    undistorted = (rays @ K[:2, :2].T + K[:2, 2]).reshape(HEIGHT, WIDTH, 2)
    (tmp_path / "images").mkdir()
    expected = {}
    for name, pose in zip(NAMES, POSES, strict=True):
        R, t = np.split(pose.w2c(), [3], axis=1)
        local = (R @ POINTS.T + t).T @ K.T
        expected[name] = local[:, :2] / local[:, 2:]
        distances2 = ((undistorted[:, :, None] - expected[name]) ** 2).sum(-1)
        dots = 250 * np.exp(-distances2 / (2 * SIGMA**2)).sum(-1)
        Image.fromarray(np.round(dots.clip(0, 255)).astype(np.uint8)).save(
            tmp_path / "images" / name
        )
    scene = read(tmp_path)
    assert len(scene.cameras) == len(NAMES)
    errors = []
    for view, name in zip(map(scene.read, scene.cameras), NAMES, strict=True):
        pixels, _ = view.camera.project(POINTS)
        assert np.abs(pixels - expected[name]).max() < 1e-4  # rows of RealEstate10K are float32
        for x, y in pixels:
            left, top = int(x) - HALF, int(y) - HALF
            window = view.image[top:, left:][: 2 * HALF + 1, : 2 * HALF + 1, 0].astype(float)
            rows, cols = np.indices(window.shape) + 0.5
            centroid = ((window * cols).sum(), (window * rows).sum()) / window.sum() + (left, top)
            errors.append(centroid - (x, y))
    # Eight bits leave 0.0075 (measured); OpenCV's steps of 1/32 pixel add half a step where a lens
    # shifts neighbours alike, which averages out over all dots.
    assert np.abs(errors).max() < (0.01 if "PINHOLE" in model else 0.025)
    assert np.abs(np.mean(errors, axis=0)).max() < 0.01
