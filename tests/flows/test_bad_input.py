"""Unusable photographs and camera files, alone and as one scene of a batch."""

import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from command import score, write_photographs
from PIL import Image

from flows.read_config import make_settings
from slgaussian import datasets
from slgaussian.storage.store import ArtifactStore

LAST = "images/view_02.png"


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """Return a small procedural room as a nerfstudio folder."""
    folder = tmp_path_factory.mktemp("bad") / "room"
    write_room(folder, seed=1)
    return folder


def write_room(folder: Path, seed: int) -> None:
    scene = datasets.load("procedural", seed=seed, objects=4, views=3, height=96, width=144)
    write_photographs(folder, {f"images/{name}.png": scene.read(name) for name in scene.cameras})


def cut_image(folder, frame):
    data = (folder / LAST).read_bytes()
    (folder / LAST).write_bytes(data[: len(data) // 2])


def other_room(folder, frame):
    write_room(folder / "other", seed=5)
    shutil.copy(folder / "other" / LAST, folder / LAST)


def other_size(folder, frame):
    with Image.open(folder / LAST) as image:
        image.resize((48, 32)).save(folder / LAST)


def no_camera(folder, frame):
    frame.clear()
    frame.update(file_path="images/elsewhere.png", fl_x=90, transform_matrix=np.eye(4).tolist())


def skew_pose(folder, frame):
    frame["transform_matrix"][0][1] += 0.3


def turn_pose(degrees, move=1.0):
    """Return the pose of the first photograph, rotated and moved."""

    def damage(folder, frame):
        first = json.loads((folder / "transforms.json").read_text())["frames"][0]
        angle = np.radians(degrees)
        turn = np.eye(4)
        turn[::2, ::2] = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
        pose = np.array(first["transform_matrix"]) @ turn
        pose[:3, 3] *= move
        frame["transform_matrix"] = pose.tolist()

    return damage


def missing_image(folder, frame):
    (folder / LAST).unlink()


def same_picture(folder, frame):
    shutil.copy(folder / "images/view_00.png", folder / LAST)


APART = "views do not overlap or have too little texture"
SAME = "'images/view_00.png' and 'images/view_02.png' are the same picture"
BAD = {
    "missing image": (missing_image, "ingest", "view_02.png: no such photograph, though trans"),
    "cut image": (cut_image, "ingest", "view_02.png: cannot be read"),
    "other room": (other_room, "geometry", APART),
    "same picture": (same_picture, "ingest", SAME),
    "other size": (other_size, "ingest", "view_02.png: is 48x32, but transforms.json says 144x96"),
    "no camera": (no_camera, "ingest", "images/elsewhere.png"),
    "skewed pose": (skew_pose, "ingest", "'images/view_02.png': camera c2w: its 3x3 part is not a"),
    "same camera": (turn_pose(0), "ingest", "taken from the same position"),
    "looks away": (turn_pose(180, move=1.1), "geometry", APART),
}


@pytest.fixture(scope="module")
def rooms(room):
    """Return damaged copies of the room's folder, by kind of damage."""
    folders = {}
    for name, (damage, *_) in BAD.items():
        folder = shutil.copytree(room, room.parent / name)
        meta = json.loads((folder / "transforms.json").read_text())
        damage(folder, meta["frames"][-1])
        (folder / "transforms.json").write_text(json.dumps(meta))
        folders[name] = folder
    return folders


@pytest.mark.parametrize("name", ["cut image", "other room"])
def test_field_ends_in_one_sentence_and_writes_nothing(rooms, name, tmp_path, slg):
    folder = rooms[name]
    photos = [folder / "images/view_00.png", folder / LAST]
    status, _, errors = slg("field", *photos, "--cameras", folder, "-o", tmp_path / "field")
    (message,) = [line for line in errors.splitlines() if "building" not in line]
    assert status == 2 and message.startswith("error: ") and BAD[name][2] in message
    assert list(tmp_path.iterdir()) == []


def test_in_a_batch_only_the_bad_scenes_are_lost(room, rooms, tmp_path, server):
    folders = {"good": room, **rooms}
    scenes = [
        {"name": name, "path": folder, "context": ["view_00.png", "view_02.png"]}
        for name, folder in folders.items()
    ]
    scenes.append({"name": "nowhere", "context": ["a", "b"]})
    scenes.append({**scenes[0], "name": "strange", "format": "stereo"})
    values = {"scenes": scenes, "out": tmp_path / "out", "size": "96x144"}
    store = ArtifactStore(tmp_path / "store")
    finished = score(make_settings(values, "test"), store)
    assert [result.scene for result in finished.results] == ["good"]
    rows = pq.read_table(tmp_path / "out" / "failures.parquet").to_pylist()
    results = {row["scene"]: row for row in rows}
    assert set(results) == {scene["name"] for scene in scenes} - {"good"}
    for name, (_, stage, sentence) in BAD.items():
        assert results[name]["stage"] == stage
        assert sentence in results[name]["reason"]
    assert not any("unexpected" in row["reason"] for row in rows)
    assert "missing a required argument: 'path'" in results["nowhere"]["reason"]
    assert "it takes nothing" in results["strange"]["reason"]

    # Once no scene is good any more, the page of the good one does not stay behind.
    values["scenes"] = scenes[-1:]
    assert score(make_settings(values, "test"), store).report is None
    assert not (tmp_path / "out" / "report.html").exists()


@pytest.mark.parametrize(
    ("photos", "sentence"),
    [
        (["view_00"], "found 1 context view(s), expected at least two"),
        (["view_00", "images/view_00.png"], "names 'images/view_00.png' twice"),
        (["view_00", "view_09"], "no view 'view_09' among the 3 that have a camera"),
        (["view_00", __file__], "no camera for this photograph"),
    ],
)
def test_photographs_that_make_no_pair(room, tmp_path, refusal, photos, sentence):
    assert sentence in refusal("field", *photos, "--cameras", room, "-o", tmp_path / "field")
