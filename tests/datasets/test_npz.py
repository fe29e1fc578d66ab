"""Cameras of an NPZ, in whatever convention its writer had: the depth in it tells which."""

import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from slgaussian import datasets
from slgaussian.datasets.npz import FLIP_YZ
from slgaussian.datasets.recognise import posed_scene
from slgaussian.errors import InputError
from slgaussian.scene import Camera, View

VIEWS = ("view_00", "view_01", "view_02")


@pytest.fixture(scope="module")
def room() -> list[View]:
    scene = datasets.load("procedural", seed=3)
    return [scene.read(name) for name in VIEWS]


@pytest.fixture(scope="module")
def folder(room: list[View], tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("photographs")
    for view in room:
        Image.fromarray(view.image).save(place / f"{view.name}.png")
    return place


def seen_by_network(
    room: list[View], width: int, height: int, cover: bool | None = None
) -> dict[str, np.ndarray]:
    """Depth and intrinsics of photographs stretched to a size; or cropped to it, or padded."""
    depth, intrinsics = [], []
    for view in room:
        x, y = width / view.camera.width, height / view.camera.height
        if cover is not None:
            x = y = max(x, y) if cover else min(x, y)
        left, top = (width - x * view.camera.width) / 2, (height - y * view.camera.height) / 2
        at = np.array([[x, 0, left], [0, y, top], [0, 0, 1.0]])
        depth.append(cv2.warpAffine(view.depth, at[:2], (width, height), flags=cv2.INTER_NEAREST))
        intrinsics.append(at @ view.camera.K)
    return {"depth": np.array(depth), "intrinsics": np.array(intrinsics)}


def stacked(room: list[View], name: str) -> np.ndarray:
    return np.array([getattr(view.camera, name) for view in room])


def layouts(room: list[View], name: str) -> tuple[str, dict[str, np.ndarray]]:
    """The sentence about how a file is read, "" if as its names say; and its arrays."""
    seen = seen_by_network(room, 504, 378)
    w2c, c2w = stacked(room, "w2c"), stacked(room, "c2w")
    vggt = {"depth": seen["depth"][None, ..., None], "intrinsic": seen["intrinsics"][None]}
    boxed = seen_by_network(room, 518, 518, cover=False)
    return {
        "vggt": ("", {**vggt, "extrinsic": w2c[None, :, :3]}),
        "dust3r": ("", {**seen_by_network(room, 512, 288, cover=True), "poses": c2w}),
        "letter-boxed": ("of padded", {**boxed, "extrinsics": w2c}),
        "inverted": ("camera-to-world in OpenCV's", {**seen, "extrinsics": c2w}),
        "opengl": ("in OpenGL's axes", {**seen, "poses": c2w @ FLIP_YZ}),
        "stored": ("as of stored", {**seen, "extrinsics": w2c, "intrinsics": stacked(room, "K")}),
    }[name]


LAYOUTS = "vggt", "dust3r", "letter-boxed", "inverted", "opengl", "stored"


@pytest.mark.parametrize("layout", LAYOUTS)
def test_cameras_are_those_of_the_photographs(layout, folder, room, tmp_path):
    said, arrays = layouts(room, layout)
    np.savez(tmp_path / "results.npz", **arrays)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        photos = [str(folder / f"{name}.png") for name in VIEWS]
        scene, named_from = posed_scene(tmp_path / "results.npz", photos)
    messages = [str(one.message) for one in caught if one.category is UserWarning]
    assert len(messages) == bool(said)
    assert all(said in message for message in messages)
    assert named_from == folder
    for view in room:
        camera: Camera = scene.cameras[f"{view.name}.png"]
        np.testing.assert_allclose(camera.K, view.camera.K, atol=1e-6)
        np.testing.assert_allclose(camera.c2w, view.camera.c2w, atol=1e-6)
        np.testing.assert_array_equal(scene.read(f"{view.name}.png").image, view.image)


def test_names_choose_among_more_photographs(folder, room, tmp_path):
    arrays = seen_by_network(room, 504, 378)
    arrays = {name: values[[2, 0]] for name, values in arrays.items()}
    poses = stacked(room, "c2w")[[2, 0]]
    np.savez(tmp_path / "a.npz", **arrays, poses=poses, names=["view_02.png", "view_00.png"])
    scene = datasets.load("npz", tmp_path / "a.npz", photographs=str(folder))
    assert sorted(scene.cameras) == ["view_00.png", "view_02.png"]
    np.testing.assert_allclose(scene.cameras["view_02.png"].c2w, room[2].camera.c2w, atol=1e-6)
    files, cameras = datasets.inputs(
        "npz", tmp_path / "a.npz", ["view_00"], photographs=str(folder)
    )
    assert files == [tmp_path / "a.npz", folder / "view_00.png"] and len(cameras) == 1


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"poses": None}, "holds no cameras"),
        ({"order": [1, 0, 2]}, "does not fit the photographs"),
        ({"intrinsics": np.full((3, 3, 3), 1e-4)}, "focal length x is"),
        ({"poses": np.eye(4)[None]}, "as many as maps"),
        ({"poses": np.zeros((3, 4, 4))}, r"a\.npz: pose \d is singular"),
    ],
)
def test_what_fits_no_photograph_is_refused(folder, room, tmp_path, change, sentence):
    arrays = {**seen_by_network(room, 504, 378), "poses": stacked(room, "c2w"), **change}
    order = arrays.pop("order", None)
    if order:
        arrays["poses"] = arrays["poses"][order]
    np.savez(
        tmp_path / "a.npz", **{n: values for n, values in arrays.items() if values is not None}
    )
    with pytest.raises(InputError, match=sentence):
        datasets.load("npz", tmp_path / "a.npz", photographs=str(folder))
