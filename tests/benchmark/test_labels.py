import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.benchmark.labels import ScenePair, read_labels, read_pairs, read_truth
from slgaussian.errors import InputError
from slgaussian.scene import Camera, View

TRIANGLE = [[2.9, 1.9], [17.4, 3.2], [9.7, 13.8]]
SQUARE = [[20.0, 10.0], [28.0, 10.0], [28.0, 18.0], [20.0, 18.0]]


def thing(category="red crate", segmentation=TRIANGLE, bbox=(2, 1, 17, 14)):
    return {"category": category, "segmentation": segmentation, "bbox": list(bbox)}


def write(folder: Path, objects, width=40, height=24, name="frame_1.png") -> Path:
    path = folder / "frame_1.json"
    info = {"name": name, "width": width, "height": height}
    path.write_text(json.dumps({"info": info, "objects": objects}))
    return path


def view_of(width: int, height: int, instances: np.ndarray | None = None) -> View:
    camera = Camera(np.diag([width, width, 1.0]), np.eye(4), width, height)
    image = np.zeros((height, width, 3), np.uint8)
    return View("images/frame_1.png", camera, image, instances=instances)


def test_points_are_truncated_then_filled(tmp_path):
    write(tmp_path, [thing()])
    expected = np.zeros((24, 40), np.uint8)
    cv2.fillPoly(expected, [np.array([[2, 1], [17, 3], [9, 13]], np.int32)], 1)
    mask = read_labels(tmp_path, "images/frame_1.png", 40, 24)["red crate"]
    assert mask.dtype == bool
    assert np.array_equal(mask, expected.astype(bool))


def test_objects_of_one_category_are_united_and_keep_their_boxes(tmp_path):
    write(tmp_path, [thing(), thing(segmentation=SQUARE, bbox=(28, 18, 20, 10)), thing("sofa")])
    one = read_labels(tmp_path, "frame_1", 40, 24)["sofa"]
    both = read_labels(tmp_path, "frame_1", 40, 24)["red crate"]
    square = np.zeros((24, 40), bool)
    square[10:19, 20:29] = True
    assert np.array_equal(both, one | square)
    pair = ScenePair("s", ("a", "b"), ("frame_1",), ("red crate",))
    truth = read_truth(tmp_path, pair, [view_of(40, 24)])
    boxes = truth.boxes["images/frame_1.png"]["red crate"]
    assert boxes.tolist() == [[2, 1, 17, 14], [20, 10, 28, 18]]


@settings(max_examples=30, deadline=None)
@given(width=st.integers(10, 90), height=st.integers(10, 90))
def test_a_mask_lands_where_the_image_lands(tmp_path_factory, width, height):
    folder = tmp_path_factory.mktemp("labels")
    write(folder, [thing(), thing("box", SQUARE, (20, 10, 28, 18))])
    full = read_labels(folder, "frame_1", 40, 24)
    fitted = read_labels(folder, "frame_1", width, height)
    for category, mask in full.items():
        moved = view_of(40, 24, mask.astype(np.int32)).resized(height, width)
        assert np.array_equal(fitted[category], moved.instances.astype(bool))
    # A box follows its pixels: its corners are where the resized camera sees them.
    pair = ScenePair("s", ("a", "b"), ("frame_1",), ("box",))
    boxes = read_truth(folder, pair, [view_of(width, height)]).boxes["images/frame_1.png"]["box"]
    before, after = view_of(40, 24).camera, view_of(40, 24).resized(height, width).camera
    rays = np.linalg.inv(before.K) @ np.array([[20, 10, 1], [28, 18, 1]], float).T
    corners = (after.K @ rays)[:2].T
    assert boxes[0] == pytest.approx(corners.ravel(), abs=1e-9)


def test_a_category_that_is_cropped_away_or_unlabelled_has_an_empty_mask(tmp_path):
    edge = thing("edge", [[0, 0], [1, 0], [1, 23], [0, 23]], (0, 0, 1, 23))
    write(tmp_path, [thing(), edge])
    pair = ScenePair("s", ("a", "b"), ("frame_1",), ("edge", "red crate", "ghost"))
    truth = read_truth(tmp_path, pair, [view_of(24, 24)])
    masks = truth.masks["images/frame_1.png"]
    assert list(masks) == ["edge", "red crate", "ghost"]
    assert [bool(mask.any()) for mask in masks.values()] == [False, True, False]
    assert truth.boxes["images/frame_1.png"]["ghost"].shape == (0, 4)


def without(record, *keys):
    for key in keys[:-1]:
        record = record[key]
    del record[keys[-1]]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda r: without(r, "info"), "'info' is missing"),
        (lambda r: without(r, "info", "width"), "'width' is missing"),
        (lambda r: without(r, "objects"), "'objects' is missing"),
        (lambda r: without(r, "objects", 0, "category"), "'category' is missing"),
        (lambda r: without(r, "objects", 0, "segmentation"), "'segmentation' is missing"),
        (lambda r: without(r, "objects", 0, "bbox"), "'bbox' is missing"),
        (lambda r: r["objects"][0].update(category=" "), "expected a word"),
        (lambda r: r["objects"][0].update(segmentation=[TRIANGLE]), "expected one polygon"),
        (lambda r: r["objects"][0].update(segmentation=TRIANGLE[:2]), "expected one polygon"),
        (lambda r: r["objects"][0].update(segmentation=[[0, 0], [1, float("nan")], [2, 2]]), "NaN"),
        (lambda r: r["objects"][0].update(bbox=[1, 2, 3]), "objects[0]"),
        (lambda r: r["objects"][0].update(bbox=[0, 0, 1, 1e12]), "a coordinate that no image has"),
        (lambda r: r["info"].update(width=float("inf")), "expected info.name"),
        (lambda r: r["info"].update(height=0), "at least 1x1"),
        (lambda r: r["info"].update(name="frame_2.png"), "drawn on 'frame_2.png'"),
        (lambda r: r.update(objects=3), "objects"),
    ],
)
def test_a_bad_label_file_is_named_with_what_is_wrong(tmp_path, damage, message):
    path = write(tmp_path, [thing()])
    record = json.loads(path.read_text())
    damage(record)
    path.write_text(json.dumps(record))
    with pytest.raises(InputError) as caught:
        read_labels(tmp_path, "frame_1.png", 40, 24)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)


def test_a_missing_or_unreadable_label_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"frame_7\.json: cannot read the label file"):
        read_labels(tmp_path, "images/frame_7.png", 40, 24)
    (tmp_path / "frame_7.json").write_text("{")
    with pytest.raises(InputError, match=r"frame_7\.json: the label file is not valid JSON"):
        read_labels(tmp_path, "images/frame_7.png", 40, 24)


def good_pairs():
    entry = {"context": ["a", "c"], "target": ["b"], "categories": ["red crate", "sofa"]}
    return {"hall": entry, "attic": {**entry, "target": ["b", "d"]}}


def test_pairs_are_read_in_file_order(tmp_path):
    path = tmp_path / "pairs.json"
    path.write_text(json.dumps(good_pairs()))
    assert read_pairs(path) == [
        ScenePair("hall", ("a", "c"), ("b",), ("red crate", "sofa")),
        ScenePair("attic", ("a", "c"), ("b", "d"), ("red crate", "sofa")),
    ]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"target": ["a"]}, "'a' is both context and target"),
        ({"context": ["a"]}, "'context' holds"),
        ({"context": ["a", "a"]}, "'context' holds"),
        ({"target": []}, "'target' holds"),
        ({"categories": None}, "'categories' is missing"),
        ({"categories": "sofa"}, "'categories' is a str"),
        ({"target": [3]}, "expected a list of names"),
    ],
)
def test_a_bad_pair_is_named_with_its_scene(tmp_path, change, message):
    path = tmp_path / "pairs.json"
    pairs = good_pairs()
    pairs["attic"].update(change)
    path.write_text(json.dumps(pairs))
    with pytest.raises(InputError) as caught:
        read_pairs(path)
    assert f"{path}: scene 'attic'" in str(caught.value)
    assert message in str(caught.value)


@pytest.mark.parametrize("text", ["[]", "{}", '{"hall": 3}', "nonsense"])
def test_an_index_that_is_not_one_is_refused(tmp_path, text):
    path = tmp_path / "pairs.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"pairs\.json"):
        read_pairs(path)


def test_the_office_labels_are_all_there(real_data):
    folder = real_data / "office"
    for pair in read_pairs(folder / "pairs.json"):
        masks = read_labels(folder / "labels", pair.targets[0], 576, 416)
        assert set(pair.categories) == set(masks)
        assert all(mask.any() for mask in masks.values())
