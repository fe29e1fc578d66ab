"""Scenes, cameras and labels of LERF-OVS and 3D-OVS."""

import json

import numpy as np
import pytest
from PIL import Image
from posed_folders import HEIGHT, WIDTH, Shot, llff_row, write_model, write_pictures

from slgaussian.benchmark.annotations import labelled_frames, read_labels
from slgaussian.datasets import load, scenes
from slgaussian.errors import InputError

NAMES = [f"frame_{i:05d}.jpg" for i in (1, 2, 3)]
CLASSES = ("white sheet", "a stack of UNO cards", "hand")
SHOTS = {name: Shot(9 - i, place=(0.1 * i, 0, 0)) for i, name in enumerate(NAMES)}


def test_lerf_ovs_scene_has_cameras_and_labels(tmp_path):
    for scene in ("ramen", "teatime"):
        write_model(tmp_path / scene / "sparse/0", SHOTS)
        write_pictures(tmp_path / scene / "images", NAMES)
    labels = tmp_path / "label/teatime"
    write_pictures(labels, [NAMES[1]])
    area = {"segmentation": [[10, 10], [30, 10], [30, 30]], "bbox": [10, 10, 30, 30]}
    sheep = {"category": "sheep", "group": 1, "layer": 1.0, "iscrowd": 0, "area": 9.0, **area}
    info = {"name": NAMES[1], "width": WIDTH, "height": HEIGHT, "depth": 3, "note": ""}
    record = {"info": info, "objects": [sheep]}
    (labels / "frame_00002.json").write_text(json.dumps(record))
    assert scenes("lerf_ovs", tmp_path) == {s: {"scene": s} for s in ("ramen", "teatime")}
    scene = load("lerf_ovs", tmp_path, "teatime")
    assert scene.name == "teatime" and list(scene.cameras) == NAMES
    assert scene.read(NAMES[2]).image.shape == (HEIGHT, WIDTH, 3)
    assert labelled_frames(labels) == {"frame_00002": ("sheep",)}
    assert read_labels(labels, NAMES[1], WIDTH, HEIGHT)["sheep"].any()
    with pytest.raises(InputError, match=r"has no scene 'bouquet'; found ramen, teatime"):
        load("lerf_ovs", tmp_path, "bouquet")


RING = np.zeros((HEIGHT, WIDTH), np.uint8)
RING[10:50, 20:70] = 255
RING[20:40, 30:60] = 0


@pytest.fixture
def bed(tmp_path):
    bed = tmp_path / "bed"
    write_pictures(bed / "images", NAMES)
    np.save(bed / "poses_bounds.npy", [llff_row((0.1 * i, 0, 0)) for i in range(3)])
    (bed / "segmentations/01").mkdir(parents=True)
    (bed / "segmentations/classes.txt").write_text("\n".join(CLASSES) + "\n\n")
    for name, mask in zip(CLASSES, (RING, RING, 0 * RING), strict=True):
        Image.fromarray(mask).save(bed / f"segmentations/01/{name}.png")
    return bed


def test_colmap_model_takes_precedence_over_poses_of_3d_ovs(bed):
    assert scenes("ovs3d", bed.parent) == {"bed": {"scene": "bed"}}
    scene = load("ovs3d", bed.parent, "bed")
    assert list(scene.cameras) == NAMES and scene.cameras[NAMES[1]].K[0, 2] == WIDTH / 2
    write_model(bed / "sparse/0", SHOTS)
    assert load("ovs3d", bed.parent, "bed").cameras[NAMES[1]].K[0, 2] == 47.3


def test_masks_of_3d_ovs_keep_holes_and_count_only_white(bed):
    labels = bed / "segmentations"
    Image.fromarray(np.where(RING > 0, 255, 254).astype(np.uint8)).save(
        labels / f"01/{CLASSES[1]}.png"
    )
    masks = read_labels(labels, "01.jpg", WIDTH, HEIGHT)
    assert list(masks) == sorted(CLASSES)
    assert all(np.array_equal(masks[name], RING > 0) for name in CLASSES[:2])
    assert not masks["hand"].any()
    assert labelled_frames(labels) == {"01": tuple(sorted(CLASSES))}


@pytest.mark.parametrize(
    ("change", "refusal"),
    [
        (lambda f: (f / "01/hand.png").unlink(), r"hand\.png: no such mask; every labelled"),
        (lambda f: (f / "01/hand.png").write_text("no"), r"hand\.png: cannot be read"),
        (lambda f: Image.fromarray(RING // 85).save(f / "01/hand.png"), "values from 0 to 3"),
        (lambda f: (f / "classes.txt").write_text("hand\nhand"), r"classes\.txt: found"),
        (lambda f: (f / "classes.txt").write_bytes(b"\xff\xfe\x00"), r"classes\.txt: cannot"),
    ],
)
def test_read_labels_error_names_damaged_file(bed, change, refusal):
    change(bed / "segmentations")
    with pytest.raises(InputError, match=refusal):
        read_labels(bed / "segmentations", "01.jpg", WIDTH, HEIGHT)
