"""Scenes become chunks, and what is there or cannot be is said before any work."""

import json

import numpy as np
import pytest
from PIL import Image

from flows.clip_sources import Packed, pack, scenes_of
from flows.config import PackSettings
from slgaussian.datasets import re10k

SMALL = PackSettings(views=3, size=(36, 64))


@pytest.fixture
def photos(tmp_path):
    """A nerfstudio folder of two small photographs."""
    folder = tmp_path / "kitchen"
    folder.mkdir()
    frames = []
    for number in range(2):
        pixels = np.full((20, 30, 3), 60 * number + 40, np.uint8)
        Image.fromarray(pixels).save(folder / f"{number}.png")
        pose = np.eye(4)
        pose[0, 3] = number
        frames.append({"file_path": f"{number}.png", "transform_matrix": pose.tolist()})
    (folder / "transforms.json").write_text(json.dumps({"fl_x": 25, "frames": frames}))
    return folder


def test_folders_and_rooms_become_clips(photos, tmp_path):
    out = tmp_path / "chunks"
    packed = pack(["procedural:3-4", str(photos)], out, SMALL)
    assert (packed.chunks, packed.clips, packed.left_out) == (["000000.torch"], 3, [])
    clips = re10k.read_chunk(out / "000000.torch")
    assert [clip.key for clip in clips] == ["procedural_3", "procedural_4", "kitchen"]
    assert [len(clip.images) for clip in clips] == [3, 3, 2]
    assert clips[2].view(1).camera.center == pytest.approx([1, 0, 0])
    assert pack(["procedural:7"], out, SMALL).chunks == ["000001.torch"]
    assert list(re10k.read_index(out))[-1] == "procedural_7"


@pytest.mark.parametrize(
    "named", ["garden", "garden/sparse/0", "garden/colmap/sparse/0", "garden/transforms.json"]
)
def test_a_scene_is_called_by_its_folder_however_its_cameras_are_named(tmp_path, named):
    place = tmp_path / named
    if place.suffix:
        place.parent.mkdir()
        place.touch()
    else:
        place.mkdir(parents=True)
    assert [scene.name for scene in scenes_of(str(place), SMALL)] == ["garden"]


def test_a_clip_that_is_there_is_left_as_it_is(tmp_path, monkeypatch):
    pack(["procedural:3"], tmp_path, SMALL)
    before = (tmp_path / "000000.torch").read_bytes()
    assert pack(["procedural:2-4"], tmp_path, SMALL).clips == 2
    assert (tmp_path / "000000.torch").read_bytes() == before
    names = [f"procedural_{seed}" for seed in (3, 2, 4)]
    assert list(re10k.read_index(tmp_path)) == names
    monkeypatch.setattr(re10k, "clip_of", lambda *_: pytest.fail("worked"))
    assert pack(["procedural:2-4"], tmp_path, SMALL) == Packed()


def test_a_source_that_cannot_be_read_costs_itself_alone(photos, tmp_path):
    (photos / "1.png").write_bytes(b"no image")
    packed = pack([str(photos), "procedural:1"], tmp_path / "chunks", SMALL)
    assert packed.clips == 1 and "1.png" in packed.left_out[0]
    assert list(re10k.read_index(tmp_path / "chunks")) == ["procedural_1"]
