"""Photographs and camera files that cannot be used: alone, and as one scene of a batch."""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from command import score
from PIL import Image

from flows.cli import app
from flows.read_config import make_settings
from slgaussian import datasets
from slgaussian.storage.store import ArtifactStore

LAST = "images/view_02.png"


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A small made-up room as a nerfstudio folder."""
    folder = tmp_path_factory.mktemp("bad") / "room"
    write_room(folder, seed=1)
    return folder


def write_room(folder: Path, seed: int) -> None:
    (folder / "images").mkdir(parents=True)
    scene = datasets.load("procedural", seed=seed, objects=4, views=3, height=96, width=144)
    frames = []
    for name, camera in scene.cameras.items():
        Image.fromarray(scene.read(name).image).save(folder / "images" / f"{name}.png")
        (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
        pose = (camera.c2w * [1, -1, -1, 1]).tolist()
        frame = {"file_path": f"images/{name}.png", "transform_matrix": pose, "w": 144, "h": 96}
        frames.append({**frame, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy})
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))


def missing_image(folder, frame):
    (folder / LAST).unlink()


def cut_image(folder, frame):
    data = (folder / LAST).read_bytes()
    (folder / LAST).write_bytes(data[: len(data) // 2])


def no_image(folder, frame):
    (folder / LAST).write_text("not a picture")


def other_room(folder, frame):
    write_room(folder / "other", seed=5)
    shutil.copy(folder / "other" / LAST, folder / LAST)


def same_picture(folder, frame):
    shutil.copy(folder / "images/view_00.png", folder / LAST)


def other_size(folder, frame):
    with Image.open(folder / LAST) as image:
        image.resize((48, 32)).save(folder / LAST)


def no_camera(folder, frame):
    frame.clear()
    frame.update(file_path="images/elsewhere.png", fl_x=90, transform_matrix=np.eye(4).tolist())


def skewed_pose(folder, frame):
    frame["transform_matrix"][0][1] += 0.3


def scaled_pose(folder, frame):
    frame["transform_matrix"][:3] = (2 * np.array(frame["transform_matrix"][:3])).tolist()


def nan_pose(folder, frame):
    frame["transform_matrix"][1][3] = float("nan")


def nan_focal(folder, frame):
    frame["fl_x"] = float("nan")


def turned(folder, frame, degrees, move=1.0):
    first = json.loads((folder / "transforms.json").read_text())["frames"][0]
    angle = np.radians(degrees)
    turn = np.eye(4)
    turn[::2, ::2] = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    pose = np.array(first["transform_matrix"]) @ turn
    pose[:3, 3] *= move
    frame["transform_matrix"] = pose.tolist()


def same_camera(folder, frame):
    turned(folder, frame, 0)


def only_turned(folder, frame):
    turned(folder, frame, 10)


def looks_away(folder, frame):
    turned(folder, frame, 180, move=1.1)


BAD = {
    missing_image: ("ingest", "view_02.png: no such photograph, though transforms.json names it"),
    cut_image: ("ingest", "view_02.png: cannot be read"),
    no_image: ("ingest", "view_02.png: cannot be read"),
    other_room: ("geometry", "views do not overlap or have too little texture"),
    same_picture: ("ingest", "'images/view_00.png' and 'images/view_02.png' are the same picture"),
    other_size: ("ingest", "view_02.png: is 48x32, but transforms.json says 144x96"),
    no_camera: ("ingest", "images/elsewhere.png"),
    skewed_pose: ("ingest", "frame 'images/view_02.png': camera c2w: its 3x3 part is not a rot"),
    scaled_pose: ("ingest", "frame 'images/view_02.png': camera c2w: its 3x3 part is not a rot"),
    nan_pose: ("ingest", "frame 'images/view_02.png': camera c2w: holds NaN"),
    nan_focal: ("ingest", "frame 'images/view_02.png': fl_x is nan"),
    same_camera: ("ingest", "taken from the same position"),
    only_turned: ("ingest", "taken from the same position"),
    looks_away: ("ingest", "do not overlap at any depth"),
}


@pytest.fixture(scope="module")
def rooms(room):
    """Folders by kind of damage, each a copy of the good room but for that."""
    folders = {}
    for damage in BAD:
        folder = room.parent / damage.__name__
        shutil.copytree(room, folder)
        meta = json.loads((folder / "transforms.json").read_text())
        damage(folder, meta["frames"][-1])
        (folder / "transforms.json").write_text(json.dumps(meta))
        folders[damage] = folder
    return folders


def build(monkeypatch, *words) -> int:
    """Exit status of ``slgaussian field WORDS``."""
    monkeypatch.setattr(sys, "argv", ["slgaussian", "field", *map(str, words)])
    with pytest.raises(SystemExit) as left:
        app.main()
    return left.value.code or 0


@pytest.mark.parametrize("damage", BAD, ids=lambda damage: damage.__name__)
def test_field_ends_in_one_sentence_and_writes_nothing(
    rooms, damage, tmp_path, monkeypatch, capsys
):
    folder = rooms[damage]
    photos = [folder / "images/view_00.png", folder / LAST]
    status = build(monkeypatch, *photos, "--cameras", folder, "-o", tmp_path / "field")
    message = [line for line in capsys.readouterr().err.splitlines() if "building" not in line]
    assert status == 2
    assert len(message) == 1
    assert message[0].startswith("error: ")
    assert BAD[damage][1] in message[0]
    assert list(tmp_path.iterdir()) == []


def test_in_a_batch_only_the_bad_scenes_are_lost(room, rooms, tmp_path, server):
    folders = {"good": room, **{damage.__name__: folder for damage, folder in rooms.items()}}
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
    for damage, (stage, sentence) in BAD.items():
        assert results[damage.__name__]["stage"] == stage
        assert sentence in results[damage.__name__]["reason"]
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
def test_photographs_that_make_no_pair(room, tmp_path, monkeypatch, capsys, photos, sentence):
    assert build(monkeypatch, *photos, "--cameras", room, "-o", tmp_path / "field") == 2
    assert sentence in capsys.readouterr().err


def test_photographs_of_one_name_are_told_apart_by_their_folders(room, tmp_path, monkeypatch):
    meta = json.loads((room / "transforms.json").read_text())
    for frame, side in zip(meta["frames"][::2], ("left", "right"), strict=True):
        (tmp_path / side).mkdir()
        shutil.copy(room / frame["file_path"], tmp_path / side / "ä 1.png")
        frame["file_path"] = f"{side}/ä 1"
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": meta["frames"][::2]}))
    monkeypatch.chdir(tmp_path)
    photos = [tmp_path / "left" / "ä 1.png", "right/ä 1.png"]
    assert build(monkeypatch, *photos, "--cameras", ".", "-o", "new/folder/field") == 0
    info = json.loads((tmp_path / "new/folder/field/field.json").read_text())
    assert list(info["cameras"]) == ["left/ä 1", "right/ä 1"]
