"""RealEstate10K: the published format, round trips, damaged chunks, images and cameras."""

import io
import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from slgaussian import datasets
from slgaussian.datasets import re10k
from slgaussian.errors import InputError
from slgaussian.scene import Camera


@pytest.fixture(scope="module")
def rooms():
    size = {"objects": 3, "views": 3, "height": 36, "width": 64}
    scenes = [datasets.load("procedural", seed=seed, **size) for seed in range(3)]
    return [replace(scene, name=f"room{seed}") for seed, scene in enumerate(scenes)]


@pytest.fixture(scope="module")
def split(rooms, tmp_path_factory):
    """Three clips in two chunks."""
    folder = tmp_path_factory.mktemp("re10k") / "train"
    clips = [re10k.encode_clip(room) for room in rooms]
    size = sum(map(len, clips[0].images)) + 1
    assert re10k.write(folder, iter(clips), chunk_bytes=size) == ["000000.torch", "000001.torch"]
    return folder


def test_scene_survives_a_round_trip(rooms, split):
    scene = datasets.load("re10k", split, "room1")
    assert scene.name == "room1" and list(scene.cameras) == ["0", "1", "2"]
    originals = map(rooms[1].read, rooms[1].cameras)
    for original, restored in zip(originals, map(scene.read, scene.cameras), strict=True):
        np.testing.assert_allclose(restored.camera.K, original.camera.K, rtol=1e-6)
        np.testing.assert_allclose(restored.camera.c2w, original.camera.c2w, atol=2e-6)
        # Of 255: the JPEG of a noisy image.
        assert np.abs(restored.image.astype(int) - original.image).mean() < 3


def test_chunks_and_index_have_the_published_format(split):
    index = json.loads((split / "index.json").read_text())
    assert index == {"room0": "000000.torch", "room1": "000000.torch", "room2": "000001.torch"}
    (entry,) = torch.load(split / "000001.torch", weights_only=True)
    assert set(entry) == {"url", "timestamps", "cameras", "images", "key"}
    assert entry["cameras"].dtype == torch.float32 and entry["cameras"].shape == (3, 18)
    assert entry["timestamps"].dtype == torch.int64
    assert all(image.dtype == torch.uint8 and image.ndim == 1 for image in entry["images"])
    assert bytes(entry["images"][0][:2].tolist()) == b"\xff\xd8"
    assert entry["cameras"][0, :4].tolist() == pytest.approx([0.9, 0.9 * 64 / 36, 0.5, 0.5])


def test_added_clips_make_new_chunks_and_equal_clips_equal_bytes(rooms, split, tmp_path):
    clips = [re10k.encode_clip(room) for room in rooms]
    assert re10k.write(tmp_path, clips[:2]) == ["000000.torch"]
    assert (tmp_path / "000000.torch").read_bytes() == (split / "000000.torch").read_bytes()
    assert re10k.write(tmp_path, clips[2:]) == ["000001.torch"]
    assert sorted(re10k.read_index(tmp_path)) == ["room0", "room1", "room2"]
    with pytest.raises(InputError, match="has a clip 'room2' already"):
        re10k.write(tmp_path, clips[2:])
    assert re10k.chunk_names(tmp_path) == ["000000.torch", "000001.torch"]


def test_transparent_pixels_survive_a_round_trip(rooms):
    opaque = np.random.default_rng(0).random((36, 64)) < 0.5
    hidden = {"view_00": opaque, "view_01": None, "view_02": np.zeros_like(opaque)}

    def read(name):
        return replace(rooms[0].read(name), opaque=hidden[name])

    clip = re10k.encode_clip(replace(rooms[0], read=read))
    data = re10k.encode_chunk([clip])
    (entry,) = torch.load(io.BytesIO(data), weights_only=True)
    assert [len(mask) > 0 for mask in entry["masks"]] == [True, False, True]
    (again,) = re10k.clips_in(data, "chunk")
    for number, expected in enumerate(hidden.values()):
        seen = again.view(number).opaque
        assert seen is None if expected is None else np.array_equal(seen, expected)
    plain = re10k.encode_clip(rooms[0])
    assert replace(again, masks=()).images == plain.images and plain.masks == ()
    for masks in (entry["masks"][:2], [torch.zeros(9)] * 3):
        file = io.BytesIO()
        torch.save([{**entry, "masks": masks}], file)
        with pytest.raises(InputError, match="its values have other types or lengths"):
            re10k.clips_in(file.getvalue(), "chunk")
    with pytest.raises(InputError, match="frame 0: its mask cannot be decoded"):
        replace(again, masks=(b"x",) * 3).view(0)


@settings(max_examples=30, deadline=None)
@given(
    st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1),
    st.tuples(*[st.floats(-10, 10)] * 3),
    st.floats(0.3, 3),
    st.floats(0.2, 0.8),
)
def test_cameras_survive_a_round_trip(turn, place, focal, middle):
    c2w = np.eye(4)
    c2w[:3, :3] = Rotation.from_quat(turn).as_matrix()
    c2w[:3, 3] = place
    K = np.array([[focal * 640, 0, middle * 640], [0, focal * 700, 170], [0, 0, 1]])
    restored = re10k.camera_from_row(re10k.row_from_camera(Camera(K, c2w, 640, 360)), 640, 360)
    np.testing.assert_allclose(restored.K, K, rtol=1e-6)
    np.testing.assert_allclose(restored.c2w, c2w, atol=1e-5)  # float32 of positions up to 10


def test_read_chunk_refuses_truncated_or_malicious_file(split, tmp_path):
    class Evil:
        def __reduce__(self):
            return (tmp_path.joinpath("ran").touch, ())

    data, payload = (split / "000000.torch").read_bytes(), io.BytesIO()
    torch.save([{"key": Evil()}], payload)
    truncated = [data[: int(share * len(data))] for share in (0.0, 0.3, 0.99)]
    for content in (*truncated, payload.getvalue(), pickle.dumps([{"key": Evil()}])):
        (tmp_path / "x.torch").write_bytes(content)
        with pytest.raises(InputError, match=r"x\.torch: cannot be read as a chunk"):
            re10k.read_chunk(tmp_path / "x.torch")
    assert not (tmp_path / "ran").exists()


def test_read_chunk_refuses_invalid_clip(split, tmp_path):
    (entry,) = torch.load(split / "000001.torch", weights_only=True)
    for change in (
        {"key": 3},
        {"cameras": entry["cameras"][:2]},
        {"timestamps": entry["cameras"][:, 0]},
        {"cameras": entry["cameras"].clone().requires_grad_()},
        {"images": [b"x"] * 3},
        {"images": [entry["images"][0][:1].expand(10**9)] * 3},
    ):
        torch.save([{**entry, **change}], tmp_path / "x.torch")
        with pytest.raises(InputError, match=r"x\.torch: clip 0: expected key, url, N images"):
            re10k.read_chunk(tmp_path / "x.torch")
    torch.save({"a": 1}, tmp_path / "x.torch")
    with pytest.raises(InputError, match="found a dict, expected a list of clips"):
        re10k.read_chunk(tmp_path / "x.torch")


def test_damaged_image_loses_only_its_own_view(split):
    clip = re10k.read_chunk(split / "000001.torch")[0]
    images = (clip.images[0][: len(clip.images[0]) // 2], b"no image", clip.images[2])
    scene = replace(clip, images=images).scene()
    assert scene.cameras["1"].width == 64
    assert scene.read("2").image.shape == (36, 64, 3)
    for name in ("0", "1"):
        with pytest.raises(InputError, match=rf"clip 'room2', frame {name}: its JPEG cannot"):
            scene.read(name)
    with pytest.raises(InputError, match="none of its 3 images"):
        replace(clip, images=(b"x",) * 3).scene()


@pytest.mark.parametrize(("column", "value"), [(6, 3.0), (9, np.nan), (0, -1.0)])
def test_scene_error_names_clip_and_frame_of_invalid_camera(split, column, value):
    clip = re10k.read_chunk(split / "000001.torch")[0]
    clip.cameras[1, column] = value
    with pytest.raises(InputError, match="clip 'room2', frame 1: "):
        clip.scene()
