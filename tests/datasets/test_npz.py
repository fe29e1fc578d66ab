"""Cameras of NPZ files, whose conventions are told from the depth in them."""

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
from tests.program_outputs import write_da3_cli

VIEWS = ("view_00", "view_01", "view_02")


@pytest.fixture(scope="module")
def room() -> list[View]:
    scene = datasets.load("procedural", seed=3)
    return [scene.read(name) for name in VIEWS]


@pytest.fixture(scope="module")
def folder(room: list[View], tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("photographs")
    for view in room:
        Image.fromarray(view.image).save(folder / f"{view.name}.png")
    return folder


def network_maps(
    room: list[View], width: int, height: int, cover: bool | None = None
) -> dict[str, np.ndarray]:
    """Depth and intrinsics at a network's size: stretched, cropped (``cover``) or padded to it."""
    depth, intrinsics = [], []
    for view in room:
        x, y = width / view.camera.width, height / view.camera.height
        if cover is not None:
            x = y = max(x, y) if cover else min(x, y)
        left, top = (width - x * view.camera.width) / 2, (height - y * view.camera.height) / 2
        warp = np.array([[x, 0, left], [0, y, top], [0, 0, 1.0]])
        depth.append(cv2.warpAffine(view.depth, warp[:2], (width, height), flags=cv2.INTER_NEAREST))
        intrinsics.append(warp @ view.camera.K)
    return {"depth": np.array(depth), "intrinsics": np.array(intrinsics)}


def stack(room: list[View], name: str) -> np.ndarray:
    return np.array([getattr(view.camera, name) for view in room])


def layouts(room: list[View], name: str) -> tuple[str, dict[str, np.ndarray]]:
    """Return what the warning on reading a file says, "" for none, and the file's arrays."""
    maps = network_maps(room, 504, 378)
    w2c, c2w = stack(room, "w2c"), stack(room, "c2w")
    vggt = {"depth": maps["depth"][None, ..., None], "intrinsic": maps["intrinsics"][None]}
    boxed = network_maps(room, 518, 518, cover=False)
    return {
        "vggt": ("", {**vggt, "extrinsic": w2c[None, :, :3]}),
        "dust3r": ("", {**network_maps(room, 512, 288, cover=True), "poses": c2w}),
        "letter-boxed": ("of padded", {**boxed, "extrinsics": w2c}),
        "inverted": ("camera-to-world in OpenCV's", {**maps, "extrinsics": c2w}),
        "opengl": ("in OpenGL's axes", {**maps, "poses": c2w @ FLIP_YZ}),
        "stored": ("as of stored", {**maps, "extrinsics": w2c, "intrinsics": stack(room, "K")}),
    }[name]


LAYOUTS = "vggt", "dust3r", "letter-boxed", "inverted", "opengl", "stored", "depth-anything.cpp"


@pytest.mark.parametrize("layout", LAYOUTS)
def test_cameras_of_every_convention_equal_the_true_ones(layout, folder, room, tmp_path):
    if layout == "depth-anything.cpp":
        warning, place = "", write_da3_cli(tmp_path / "depth", room)
    else:
        warning, arrays = layouts(room, layout)
        np.savez(place := tmp_path / "results.npz", **arrays)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        files = [str(folder / f"{name}.png") for name in VIEWS]
        scene, start = posed_scene(place, files)
    messages = [str(item.message) for item in caught if item.category is UserWarning]
    assert len(messages) == bool(warning)
    assert all(warning in message for message in messages)
    assert start == folder
    for view in room:
        camera: Camera = scene.cameras[f"{view.name}.png"]
        np.testing.assert_allclose(camera.K, view.camera.K, atol=1e-6)
        np.testing.assert_allclose(camera.c2w, view.camera.c2w, atol=1e-6)
        np.testing.assert_array_equal(scene.read(f"{view.name}.png").image, view.image)


def test_names_assign_cameras_to_some_photographs_of_a_folder(folder, room, tmp_path):
    arrays = {**network_maps(room, 504, 378), "poses": stack(room, "c2w")}
    arrays = {name: values[[2, 0]] for name, values in arrays.items()}
    np.savez(tmp_path / "a.npz", **arrays, names=["view_02.png", "view_00.png"])
    scene = datasets.load("npz", tmp_path / "a.npz", photographs=str(folder))
    assert sorted(scene.cameras) == ["view_00.png", "view_02.png"]
    np.testing.assert_allclose(scene.cameras["view_02.png"].c2w, room[2].camera.c2w, atol=1e-6)
    files, cameras = datasets.inputs(
        "npz", tmp_path / "a.npz", ["view_00"], photographs=str(folder)
    )
    assert files == [tmp_path / "a.npz", folder / "view_00.png"] and len(cameras) == 1


@pytest.mark.parametrize(
    ("change", "refusal"),
    [
        (lambda arrays: arrays.pop("poses"), "holds no cameras"),
        (lambda arrays: arrays.update(poses=arrays["poses"][[1, 0, 2]]), "does not fit the photo"),
        (lambda arrays: arrays.update(intrinsics=np.full((3, 3, 3), 1e-4)), "focal length x is"),
        (lambda arrays: arrays.update(poses=np.eye(4)[None]), "as many as maps"),
        (lambda arrays: arrays["poses"].fill(0), r"a\.npz: pose \d is singular"),
    ],
    ids=["no poses", "poses swapped", "tiny focal length", "one pose of three", "zero poses"],
)
def test_load_refuses_cameras_that_fit_no_photographs(folder, room, tmp_path, change, refusal):
    arrays = {**network_maps(room, 504, 378), "poses": stack(room, "c2w")}
    change(arrays)
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(InputError, match=refusal):
        datasets.load("npz", tmp_path / "a.npz", photographs=str(folder))
