"""Names of photographs: natural order, uniqueness, and files that fit one photograph only."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from posed_folders import HEIGHT, WIDTH, write_pictures

from slgaussian import datasets
from slgaussian.benchmark.annotations import Truth, read_truth
from slgaussian.benchmark.external_predictions import (
    JudgedScene,
    read_predictions,
    score_predictions,
)
from slgaussian.benchmark.outputs import mask_paths
from slgaussian.benchmark.protocols import load_protocol
from slgaussian.checks import companion, match_rank, matching, natural_key, order_naturally
from slgaussian.datasets import unposed
from slgaussian.datasets.sources import Photographs
from slgaussian.errors import InputError
from slgaussian.formats.depth_maps import read_geometry
from slgaussian.masks.precomputed import Precomputed
from slgaussian.predict.precomputed import find_maps
from slgaussian.scene import Camera, Sample, Scene
from tasks.artifacts import sample_from_arrays, sample_to_arrays

STEREO = ("left/0001.jpg", "right/0001.jpg", "left/0002.jpg")


def write_scene(root, names=STEREO):
    """Write a scene of nerfstudio's form with cameras side by side."""
    write_pictures(root, names)
    frames = []
    for k, name in enumerate(names):
        pose = np.eye(4)
        pose[0, 3] = k
        frames.append({"file_path": name, "transform_matrix": pose.tolist()})
    content = {"fl_x": 80.0, "w": WIDTH, "h": HEIGHT, "frames": frames}
    (root / "transforms.json").write_text(json.dumps(content))
    return datasets.load("nerfstudio", root)


def write_label(file, name):
    box = [[2, 2], [20, 2], [20, 20], [2, 20]]
    labelled = {"category": "cup", "segmentation": box, "bbox": [2, 2, 20, 20]}
    info = {"name": name, "width": WIDTH, "height": HEIGHT}
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps({"info": info, "objects": [labelled]}))


def read_labels(root, view):
    return read_truth(root, ["cup"], [view]).masks[view.name]["cup"]


def read_ids(root, view):
    return Precomputed(folder=root).propagate(SimpleNamespace(view=view))


def read_depth(root, view):
    return find_maps(root, SimpleNamespace(scene="s", context=[view]))[0].depth


def write_ids(file, name):
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full((HEIGHT, WIDTH), 7, np.uint16)).save(file)


READ = {
    "labels": (read_labels, write_label, ".json"),
    "ids": (read_ids, write_ids, ".png"),
    "depth": (read_depth, write_ids, ".png"),
}


@pytest.mark.parametrize("kind", READ)
def test_readers_refuse_companion_of_two_photographs(tmp_path, kind):
    read, write, suffix = READ[kind]
    scene, folder = write_scene(tmp_path / "scene"), tmp_path / kind
    left, right, second = scene.views(STEREO, "original")
    write(folder / f"0001{suffix}", "0001.jpg")
    write(folder / f"0002{suffix}", "0002.jpg")
    assert read(folder, second).any()  # no other photograph has this name
    for view, other in (left, right), (right, left):
        with pytest.raises(InputError, match=f"fits two .*{view.name!r} and {other.name!r}"):
            read(folder, view)
    (folder / f"0001{suffix}").unlink()
    write(folder / "left" / f"0001{suffix}", left.name)
    assert read(folder, left).any()
    with pytest.raises(InputError, match="0001"):
        read(folder, right)


def test_read_truth_refuses_labels_of_another_photograph(tmp_path):
    left, right, _ = write_scene(tmp_path / "scene").views(STEREO, "original")
    for name, fits in ("0001.jpg", True), (r"left\0001.jpg", True), (right.name, False):
        write_label(tmp_path / "labels/left/0001.json", name)
        if fits:
            assert read_labels(tmp_path / "labels", left).any()
            continue
        with pytest.raises(InputError, match=r"was drawn on 'right/0001\.jpg'"):
            read_labels(tmp_path / "labels", left)


def test_read_truth_refuses_class_masks_of_two_photographs(tmp_path):
    left, _, second = write_scene(tmp_path / "scene").views(STEREO, "original")
    folder = tmp_path / "segmentations"
    for frame in "0001", "0002":
        (folder / frame).mkdir(parents=True)
        Image.new("L", (WIDTH, HEIGHT), 255).save(folder / frame / "cup.png")
    (folder / "classes.txt").write_text("cup")
    assert read_labels(folder, second).all()
    with pytest.raises(InputError, match="fits two"):
        read_labels(folder, left)


def test_geometry_file_matches_maps_by_path(tmp_path):
    def numbers(names, views, others=()):
        file, count = tmp_path / "maps.npz", len(names or views)
        arrays = {"depth": np.ones((count, 4, 6), np.float32)}
        np.savez(file, **arrays, **({"names": np.array(names)} if names else {}))
        return read_geometry(file).numbers(views, others)

    windows = [name.replace("/", "\\") for name in STEREO]
    assert numbers(windows, STEREO) == dict(zip(STEREO, range(3), strict=True))
    assert numbers(["/data/right/0001.png", "/data/left/0001.png"], STEREO[:2]) == {
        STEREO[0]: 1, STEREO[1]: 0
    }  # fmt: skip
    assert numbers(["x/b.png", "x/a.png"], ["images/a.jpg"]) == {"images/a.jpg": 1}
    for names, views, others, says in (
        (["0001"], STEREO[:2], (), "fits two photographs"),
        (["0001"], STEREO[:1], STEREO[1:], "fits two photographs"),
        (["p/a", "q/a"], ["images/a.jpg"], (), "both fit"),
        (["a", "a"], ["a.jpg"], (), "two maps named"),
        (None, [f"{k}.jpg" for k in range(12)], (), "order is open"),
    ):
        with pytest.raises(InputError, match=says):
            numbers(names, views, others)
    assert len(numbers(None, sorted(f"{k}.jpg" for k in range(12)))) == 12


def test_score_predictions_refuses_masks_that_fit_two_frames(tmp_path):
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[:9] = True
    frames = {name: {"cup": mask} for name in STEREO[:2]}
    judged = JudgedScene("s", "d", None, Truth(frames))

    def score(place):
        return next(
            score_predictions(read_predictions(place), [judged], [load_protocol("slgaussian")])
        )

    entry = {"scene": "s", "query": "cup", "size": [HEIGHT, WIDTH]}
    entry["counts"] = [0, HEIGHT * WIDTH]
    file = tmp_path / "masks.json"
    file.write_text(json.dumps([{**entry, "frame": "0001.png"}]))
    with pytest.raises(InputError, match="fits two photographs, 'left/0001"):
        score(file)
    file.write_text(json.dumps([{**entry, "frame": r"left\0001.png"}]))
    assert [row["note"] for row in score(file).rows] == ["", "no mask was given"]
    # What a run writes for two frames of one name is read back for each.
    rows = [{"method": "m", "protocol": "slgaussian@2", "scene": "s", "query": "cup", "frame": name}
            for name in frames]  # fmt: skip
    for path, value in zip(mask_paths(rows), (255, 0), strict=True):
        (tmp_path / "out" / path).parent.mkdir(parents=True)
        Image.fromarray(np.uint8(mask) * np.uint8(value)).save(tmp_path / "out" / path)
    ious = [row["iou"] for row in score(tmp_path / "out").rows]
    assert ious == [1.0, 0.0]


def test_order_naturally_sorts_only_names_in_the_order_of_letters(tmp_path):
    frames = [f"frame_{k}.jpg" for k in range(1, 13)]
    assert order_naturally(sorted(frames)) == frames
    assert order_naturally(frames[::-1]) == frames[::-1]  # somebody's intention
    mixed = ["a", "a 2.png", "a10/b", "a2/b", "a2/b1", "b.PNG", "b1.png"]
    assert sorted(mixed, key=natural_key) == [mixed[k] for k in (0, 3, 4, 2, 1, 5, 6)]
    scene = write_scene(tmp_path, sorted(frames))
    assert list(scene.cameras) == frames
    assert list(unposed.name_files([tmp_path])) == frames
    assert list(unposed.name_files([tmp_path / name for name in sorted(frames)])) == frames
    assert list(unposed.name_files([tmp_path / name for name in frames[::-1]])) == frames[::-1]


def test_scene_refuses_two_names_of_one_photograph(tmp_path):
    write_pictures(tmp_path, ["a.jpg", "b.jpg"])
    for again in "./a.jpg", "a.jpg/", ".//a.jpg":
        with pytest.raises(InputError, match="name one photograph"):
            write_scene(tmp_path / "scene", ["a.jpg", again])


def test_namesakes_reach_stored_samples_and_cache_keys(tmp_path):
    scene = write_scene(tmp_path)
    sample = scene.sample(STEREO[::2], size="original")
    stored = sample_from_arrays(sample_to_arrays(sample))
    assert [view.namesakes for view in stored.context] == [("right/0001.jpg",), ()]
    given = Sample("memory", scene.views(STEREO[:2], "original"))
    assert given.context[0].namesakes == ("right/0001.jpg",)

    def key():
        return Photographs("s", "nerfstudio", tmp_path, context=STEREO[::2]).look()["cameras"]

    before = key()
    write_scene(tmp_path, [*STEREO, "right/0003.jpg"])
    assert key() == before
    write_scene(tmp_path, [*STEREO, "up/0002.jpg"])
    assert key() != before


def test_companions_are_ranked_by_their_paths(tmp_path):
    ranks = {"a/1.jpg": 4, r"a\1.jpg": 4, "a/1.png": 3, "a/1": 3, "1.png": 2, "/d/a/1.png": 2,
             "b/1.jpg": 1, "a/2.jpg": 0, "a": 0}  # fmt: skip
    assert {entry: match_rank(entry, "a/1.jpg") for entry in ranks} == ranks
    assert match_rank("frame.0001", "frame.0001.jpg") == 3
    assert match_rank("frame.0002", "frame.0001.jpg") == 0
    assert matching("x", "a/1.jpg", ["1.jpg", "a/1.png"], ["b/1.jpg"]) == "a/1.png"
    for name in "a.jpg.png", "b.png":
        (tmp_path / name).touch()
    assert companion(tmp_path, "a.jpg", [".png"], ["a.png"]).name == "a.jpg.png"
    assert companion(tmp_path, "deep/b.jpg", [".png"], ["a.jpg"]).name == "b.png"
    assert companion(tmp_path, "c.jpg", [".png"]) is None
    with pytest.raises(InputError, match="fits two photographs"):
        companion(tmp_path, "b.jpg", [".png"], ["b.png"])


@pytest.mark.parametrize(
    ("focal", "centre", "refusal"),
    [(0.8, 48, "focal length x is 0.8"), (80, 0.5, r"principal point is \(0.5, 0.5\)")],
)
def test_scene_of_any_origin_refuses_implausible_cameras_by_view(focal, centre, refusal):
    K = np.array([[focal, 0, centre], [0, focal, centre], [0, 0, 1]])
    with pytest.raises(InputError, match=rf"^scene 'memory': 'a': {refusal}"):
        Scene("memory", {"a": Camera(K, np.eye(4), WIDTH, HEIGHT)}, lambda name: None)
