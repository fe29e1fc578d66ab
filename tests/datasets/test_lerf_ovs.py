import json

import pytest
from posed_folders import HEIGHT, WIDTH, Shot, write_model, write_pictures

from slgaussian.benchmark.annotations import labelled_frames, read_labels
from slgaussian.datasets import load, scenes
from slgaussian.errors import InputError

NAMES = [f"frame_{i:05d}.jpg" for i in (1, 2, 3)]


@pytest.fixture
def folder(tmp_path):
    for scene in ("ramen", "teatime"):
        shots = {name: Shot(9 - i, place=(0.1 * i, 0, 0)) for i, name in enumerate(NAMES)}
        write_model(tmp_path / scene / "sparse/0", shots)
        write_pictures(tmp_path / scene / "images", NAMES)
        (tmp_path / "label" / scene).mkdir(parents=True)
    record = {
        "info": {"name": NAMES[1], "width": WIDTH, "height": HEIGHT, "depth": 3, "note": ""},
        "objects": [
            {
                "category": "sheep", "group": 1, "layer": 1.0, "iscrowd": 0, "area": 9.0,
                "segmentation": [[10, 10], [30, 10], [30, 30]], "bbox": [10, 10, 30, 30],
            }
        ],
    }  # fmt: skip
    (tmp_path / "label/teatime/frame_00002.json").write_text(json.dumps(record))
    write_pictures(tmp_path / "label/teatime", [NAMES[1]])
    return tmp_path


def test_scenes_and_their_labels_are_read(folder):
    assert scenes("lerf_ovs", folder) == {s: {"scene": s} for s in ("ramen", "teatime")}
    scene = load("lerf_ovs", folder, "teatime")
    assert scene.name == "teatime"
    assert list(scene.cameras) == NAMES
    assert scene.read(NAMES[2]).image.shape == (HEIGHT, WIDTH, 3)
    labels = folder / "label" / "teatime"
    assert labelled_frames(labels) == {"frame_00002": ("sheep",)}
    assert read_labels(labels, NAMES[1], WIDTH, HEIGHT)["sheep"].any()


def test_an_unknown_scene_is_said_with_those_there(folder):
    with pytest.raises(InputError, match=r"has no scene 'bouquet'; found ramen, teatime"):
        load("lerf_ovs", folder, "bouquet")
    with pytest.raises(InputError, match=r"found none \(give the folder of the whole set\)"):
        load("lerf_ovs", folder / "ramen", "ramen")
