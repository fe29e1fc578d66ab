import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.benchmark.annotations import labelled_frames, read_labels, read_truth
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


def view_of(width: int, height: int, opaque: np.ndarray | None = None) -> View:
    camera = Camera(np.diag([width, width, 1.0]), np.eye(4), width, height)
    image = np.zeros((height, width, 3), np.uint8)
    return View("images/frame_1.png", camera, image, opaque=opaque)


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
    asked = ("red crate",)
    truth = read_truth(tmp_path, asked, [view_of(40, 24)])
    boxes = truth.boxes["images/frame_1.png"]["red crate"]
    assert boxes.tolist() == [[2, 1, 17, 14], [20, 10, 28, 18]]


class TestHoles:
    RING = ([[5, 5], [25, 5], [25, 20], [5, 20]], [[10, 9], [20, 9], [20, 15], [10, 15]])

    def mask(self, folder, *objects):
        write(folder, objects)
        return read_labels(folder, "frame_1", 40, 24)["red crate"]

    def test_a_hole_is_cut_out_of_its_own_object_only(self, tmp_path):
        outer, hole = self.RING
        ring = {**thing(segmentation=outer), "holes": [hole]}
        whole = self.mask(tmp_path, thing(segmentation=outer))
        cut = self.mask(tmp_path, ring)
        inside = np.zeros_like(whole)
        inside[10:15, 11:20] = True  # the edge of a hole belongs to the object
        assert np.array_equal(cut, whole & ~inside)
        # Another piece of the category, seen through the hole.
        piece = thing(segmentation=[[12, 11], [16, 11], [16, 13], [12, 13]])
        for pair in ((ring, piece), (piece, ring)):
            both = self.mask(tmp_path, *pair)
            assert both[11:14, 12:17].all()
            assert both.sum() == cut.sum() + 15


def test_frames_of_one_name_in_two_folders_have_their_own_labels(tmp_path):
    for folder, category in (("left", "sofa"), ("right", "door")):
        (tmp_path / folder).mkdir()
        write(tmp_path / folder, [thing(category)])
    write(tmp_path, [thing("table")])
    for view, category in (("left", "sofa"), ("right", "door"), ("images", "table")):
        assert list(read_labels(tmp_path, f"{view}/frame_1.png", 40, 24)) == [category]
    assert labelled_frames(tmp_path) == {
        "frame_1": ("table",),
        "left/frame_1": ("sofa",),
        "right/frame_1": ("door",),
    }


@settings(max_examples=30, deadline=None)
@given(width=st.integers(10, 90), height=st.integers(10, 90))
def test_a_mask_lands_where_the_image_lands(tmp_path_factory, width, height):
    folder = tmp_path_factory.mktemp("labels")
    write(folder, [thing(), thing("box", SQUARE, (20, 10, 28, 18))])
    full = read_labels(folder, "frame_1", 40, 24)
    fitted = read_labels(folder, "frame_1", width, height)
    for category, mask in full.items():
        moved = view_of(40, 24, mask).resized(height, width)
        assert np.array_equal(fitted[category], moved.opaque)
    # A box follows its pixels: its corners are where the resized camera sees them.
    asked = ("box",)
    view = view_of(40, 24).resized(height, width)
    boxes = read_truth(folder, asked, [view]).boxes["images/frame_1.png"]["box"]
    before, after = view_of(40, 24).camera, view.camera
    rays = np.linalg.inv(before.K) @ np.array([[20, 10, 1], [28, 18, 1]], float).T
    corners = (after.K @ rays)[:2].T
    assert boxes[0] == pytest.approx(corners.ravel(), abs=1e-9)


def test_a_category_that_is_cropped_away_or_unlabelled_has_an_empty_mask(tmp_path):
    edge = thing("edge", [[0, 0], [1, 0], [1, 23], [0, 23]], (0, 0, 1, 23))
    write(tmp_path, [thing(), edge])
    asked = ("edge", "red crate", "ghost")
    truth = read_truth(tmp_path, asked, [view_of(40, 24).resized(24, 24)])
    masks = truth.masks["images/frame_1.png"]
    assert list(masks) == ["edge", "red crate", "ghost"]
    assert [bool(mask.any()) for mask in masks.values()] == [False, True, False]
    assert truth.boxes["images/frame_1.png"]["ghost"].shape == (0, 4)


MISSING = object()


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        ("info", MISSING, "info is missing"),
        ("objects.0.bbox", MISSING, "objects.0.bbox is missing"),
        ("objects.0.category", " ", "objects.0.category: found ' '"),
        ("objects.0.segmentation", [TRIANGLE], "objects.0.segmentation"),
        ("objects.0.segmentation", TRIANGLE[:2], "objects.0.segmentation"),
        ("objects.0.segmentation.1.1", float("nan"), "objects.0.segmentation.1.1: found nan"),
        ("objects.0.bbox", [1, 2, 3], "objects.0.bbox"),
        ("objects.0.bbox.3", 1e12, "objects.0.bbox.3: found 1"),
        ("objects.0.holes", [[[1, 2], [3, 4]]], "objects.0"),
        ("info.width", float("inf"), "info.width: found inf"),
        ("info.name", "frame_2.png", "drawn on 'frame_2.png'"),
    ],
)
def test_a_bad_label_file_is_named_with_what_is_wrong(tmp_path, place, value, message):
    path = write(tmp_path, [thing()])
    content = node = json.loads(path.read_text())
    *above, last = (int(key) if key.isdigit() else key for key in place.split("."))
    for key in above:
        node = node[key]
    if value is MISSING:
        del node[last]
    else:
        node[last] = value
    path.write_text(json.dumps(content))
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
