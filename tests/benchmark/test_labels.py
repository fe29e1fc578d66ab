"""Labels of frames: polygons, holes and boxes, their place in a resized view, and bad files."""

import json
from contextlib import nullcontext
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.benchmark.annotations import (
    label_files,
    labelled_frames,
    read_labels,
    read_truth,
)
from slgaussian.errors import InputError
from slgaussian.formats.resampling import Window
from slgaussian.scene import Camera, View

TRIANGLE = [[2.9, 1.9], [17.4, 3.2], [9.7, 13.8]]
SQUARE = [[20.0, 10.0], [28.0, 10.0], [28.0, 18.0], [20.0, 18.0]]
NAME = "images/frame_1.png"


def thing(category="red crate", segmentation=TRIANGLE, bbox=None, **more):
    x, y = zip(*segmentation, strict=True)
    bbox = bbox or (min(x), min(y), max(x), max(y))
    return {"category": category, "segmentation": segmentation, "bbox": list(bbox), **more}


def write(folder: Path, *objects) -> Path:
    path = folder / "frame_1.json"
    info = {"name": "frame_1.png", "width": 40, "height": 24}
    path.write_text(json.dumps({"info": info, "objects": objects}))
    return path


def read(folder: Path, *objects) -> dict[str, np.ndarray]:
    write(folder, *objects)
    return read_labels(folder, NAME, 40, 24)


def make_view(opaque: np.ndarray | None = None) -> View:
    camera = Camera(np.diag([40, 40, 1.0]), np.eye(4), 40, 24)
    return View(NAME, camera, np.zeros((24, 40, 3), np.uint8), opaque=opaque)


def test_read_labels_truncates_points_and_unites_a_category(tmp_path):
    expected = np.zeros((24, 40), np.uint8)
    cv2.fillPoly(expected, [np.array([[2, 1], [17, 3], [9, 13]], np.int32)], 1)
    square = np.zeros((24, 40), bool)
    square[10:19, 20:29] = True
    both = (
        thing(bbox=(2, 1, 17, 14)),
        thing(segmentation=SQUARE, bbox=(28, 18, 20, 10)),
        thing("sofa"),
    )
    masks = read(tmp_path, *both)
    assert masks["sofa"].dtype == bool
    assert np.array_equal(masks["sofa"], expected.astype(bool))
    assert np.array_equal(masks["red crate"], masks["sofa"] | square)
    boxes = read_truth(tmp_path, ["red crate"], [make_view()]).boxes[NAME]["red crate"]
    assert boxes.tolist() == [[2, 1, 17, 14], [20, 10, 28, 18]]


def test_read_labels_cuts_a_hole_from_its_object_only(tmp_path):
    outer = [[5, 5], [25, 5], [25, 20], [5, 20]]
    ring = thing("crate", outer, holes=[[[10, 9], [20, 9], [20, 15], [10, 15]]])
    inside = np.zeros((24, 40), bool)
    inside[10:15, 11:20] = True  # the edge of a hole belongs to the object
    cut = read(tmp_path, ring)["crate"]
    # Even-odd: the middle of a star, which two of its points overlap, is outside.
    star = read(tmp_path, thing("star", [[20, 1], [27, 22], [6, 8], [34, 8], [13, 22]]))["star"]
    assert star[[4, 9, 12, 20], [20, 11, 20, 24]].tolist() == [True, True, False, True]
    assert np.array_equal(cut, read(tmp_path, thing("crate", outer))["crate"] & ~inside)
    # Another piece of the category, seen through the hole.
    piece = thing("crate", [[12, 11], [16, 11], [16, 13], [12, 13]])
    for pair in ((ring, piece), (piece, ring)):
        both = read(tmp_path, *pair)["crate"]
        assert both[11:14, 12:17].all() and both.sum() == cut.sum() + 15


def test_read_labels_distinguishes_equal_names_in_two_folders(tmp_path):
    for folder, category in (("left", "sofa"), ("right", "door"), (".", "table")):
        (tmp_path / folder).mkdir(exist_ok=True)
        write(tmp_path / folder, thing(category))
    for view, category in (("left", "sofa"), ("right", "door"), ("images", "table")):
        assert list(read_labels(tmp_path, f"{view}/frame_1.png", 40, 24)) == [category]
    frames = {"frame_1": ("table",), "left/frame_1": ("sofa",), "right/frame_1": ("door",)}
    assert labelled_frames(tmp_path) == frames


@settings(max_examples=30, deadline=None)
@given(width=st.integers(10, 90), height=st.integers(10, 90))
def test_read_labels_resamples_masks_as_the_image(tmp_path_factory, width, height):
    folder = tmp_path_factory.mktemp("labels")
    full = read(folder, thing(), thing("box", SQUARE, (20, 10, 28, 18)))
    fitted = read_labels(folder, NAME, width, height)
    for category, mask in full.items():
        assert np.array_equal(fitted[category], make_view(mask).resize(height, width).opaque)
    # A box follows its pixels: its corners are where the resized camera sees them.
    view = make_view().resize(height, width)
    boxes = read_truth(folder, ["box"], [view]).boxes[NAME]["box"]
    rays = np.linalg.inv(make_view().camera.K) @ np.array([[20, 10, 1], [28, 18, 1]], float).T
    corners = (view.camera.K @ rays)[:2].T
    assert boxes[0] == pytest.approx(corners.ravel(), abs=1e-9)


def test_read_truth_gives_an_empty_mask_to_an_absent_category(tmp_path):
    write(tmp_path, thing(), thing("edge", [[0, 0], [1, 0], [1, 23], [0, 23]], (0, 0, 1, 23)))
    categories = ["edge", "red crate", "ghost"]
    truth = read_truth(tmp_path, categories, [make_view().resize(24, 24)])
    is_visible = {category: bool(mask.any()) for category, mask in truth.masks[NAME].items()}
    assert list(is_visible.items()) == [("edge", False), ("red crate", True), ("ghost", False)]
    assert truth.boxes[NAME]["ghost"].shape == (0, 4)


NEAR = [[4, 1], [22, 1], [22, 20], [4, 20]]
LARGE = [[10, 4], [30, 4], [30, 16], [10, 16]]


@pytest.mark.parametrize(
    ("polygon", "bbox", "expected"),
    [
        (LARGE, (10, 4, 20, 12), (10, 4, 30, 16)),  # COCO's form
        (TRIANGLE, (2.9, 1.9, 14.5, 11.9), (2.9, 1.9, 17.4, 13.8)),
        (LARGE, (7, 3, 33, 18), (7, 3, 33, 18)),  # drawn loosely
        (LARGE, (30, 16, 10, 4), (10, 4, 30, 16)),
    ],
)
def test_read_truth_detects_the_form_of_a_box_by_its_polygon(tmp_path, polygon, bbox, expected):
    write(tmp_path, thing("crate", polygon, bbox), thing("sofa"))
    is_coco = not np.allclose(np.sort(np.reshape(bbox, (2, 2)), 0).ravel(), expected)
    says = pytest.warns(UserWarning, match=r"frame_1\.json: 1 boxes are x, y, width, height, as th")
    with says if is_coco else nullcontext():
        boxes = read_truth(tmp_path, ["crate", "sofa"], [make_view()]).boxes[NAME]
    np.testing.assert_allclose(boxes["crate"], [expected])
    np.testing.assert_allclose(boxes["sofa"], [(2.9, 1.9, 17.4, 13.8)])


def test_read_truth_accepts_one_box_of_several_parts(tmp_path):
    whole, rest = (2.9, 1.9, 28, 18), (20, 10, 28, 18)
    write(tmp_path, thing("tap", TRIANGLE, whole), thing("tap", SQUARE, rest))
    boxes = read_truth(tmp_path, ["tap"], [make_view()]).boxes[NAME]["tap"]
    np.testing.assert_allclose(boxes, [whole, rest])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"segmentation": [[0.2, 0.1], [0.8, 0.1], [0.5, 0.9]]}, "0.2, 0.1, 0.8, 0.9, a pixel at"),
        ({"segmentation": [[20, 14], [50, 14], [50, 16]]}, "20, 14, 50, 16, outside the 40x24"),
        ({"segmentation": LARGE, "bbox": (0.25, 0.2, 0.75, 0.7)}, "its box is 0.25, 0.2, 0.75, 0"),
        ({"segmentation": LARGE, "bbox": (4, 10, 16, 30)}, "its box is 4, 10, 16, 30, but its pol"),
        (
            {"segmentation": NEAR, "bbox": (1, 4, 20, 22)},
            "its box is 1, 4, 20, 22, but its polygon",
        ),
        ({"segmentation": LARGE, "bbox": (20, 10, 20, 12)}, "spans 10, 4, 30, 16; give x0, y0"),
        (
            {"segmentation": LARGE, "holes": [[[20, 10], [28, 10], [28, 28]]]},
            "a hole of it 20, 10, 28, 28",
        ),
    ],
    ids=[
        "fractions",
        "another size",
        "box in fractions",
        "rows first",
        "rows first, similar",
        "centre",
        "hole",
    ],
)
def test_read_labels_refuses_contradictory_numbers(tmp_path, wrong, message):
    with pytest.raises(InputError, match=rf"frame_1\.json: 'cup': .*{message}"):
        read(tmp_path, thing(), thing("cup", **wrong))


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
        ("objects.0.bbox", [[1, 2], 3], "objects.0.bbox"),
        ("objects.0.bbox.3", 1e12, "objects.0.bbox.3: found 1"),
        ("objects.0.holes", [[[1, 2], [3, 4]]], "objects.0"),
        ("info.width", float("inf"), "info.width: found inf"),
        ("info.name", "frame_2.png", "drawn on 'frame_2.png'"),
    ],
)
def test_read_labels_names_an_invalid_field(tmp_path, place, value, message):
    path = write(tmp_path, thing())
    content = node = json.loads(path.read_text())
    *above, last = (int(key) if key.isdigit() else key for key in place.split("."))
    for key in above:
        node = node[key]
    node[last] = value
    if value is MISSING:
        del node[last]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError) as caught:
        read_labels(tmp_path, NAME, 40, 24)
    assert str(path) in str(caught.value) and message in str(caught.value)


def test_read_labels_names_a_missing_or_damaged_file(tmp_path):
    with pytest.raises(InputError, match=r"frame_7\.json: cannot read the label file"):
        read_labels(tmp_path, "images/frame_7.png", 40, 24)
    (tmp_path / "frame_7.json").write_text("{")
    with pytest.raises(InputError, match=r"frame_7\.json: the label file is not valid JSON"):
        read_labels(tmp_path, "images/frame_7.png", 40, 24)


def write_coco(file: Path) -> None:
    """Write labels of two of three images: polygons, run lengths, and a crowd."""
    flat = np.ravel(SQUARE).tolist()
    runs = {"size": [24, 40], "counts": [24 * 30, 24 * 2, 24 * 8]}  # columns 30 and 31
    shapes = [(1, 1, flat, 0), (1, 2, flat, 0), (1, 1, runs, 1), (2, 2, flat, 0)]
    annotations = [
        {"image_id": image, "category_id": category, "iscrowd": crowd, "id": number}
        | {"segmentation": shape if crowd else [shape]}
        for number, (image, category, shape, crowd) in enumerate(shapes)
    ]
    names = {1: "frame_1.png", 2: "right/frame_2.png", 3: "frame_3.png"}
    images = [{"id": i, "file_name": n, "width": 40, "height": 24} for i, n in names.items()]
    categories = [{"id": 1, "name": "red crate"}, {"id": 2, "name": "sofa"}]
    document = {"images": images, "annotations": annotations, "categories": categories}
    file.write_text(json.dumps(document))


@pytest.mark.parametrize("place", [".", "all.json"])
def test_labels_of_coco_unite_a_category_and_leave_unlabelled_images_out(tmp_path, place):
    write_coco(tmp_path / "all.json")
    folder = tmp_path / place
    frames = {"frame_1": ("red crate", "sofa"), "right/frame_2": ("sofa",)}
    assert labelled_frames(folder) == frames
    assert label_files(folder, NAME) == [tmp_path / "all.json"]
    square = np.zeros((24, 40), bool)
    square[10:18, 20:28] = True
    both = square.copy()
    both[:, 30:32] = True
    truth = read_truth(folder, ["red crate", "sofa", "ghost"], [make_view()])
    for category, mask in (("red crate", both), ("sofa", square), ("ghost", square & ~square)):
        np.testing.assert_array_equal(truth.masks[NAME][category], mask)
    boxes = truth.boxes[NAME]["red crate"].tolist()
    assert boxes == [[20, 10, 28, 18], [30, 0, 32, 24]]
    halved = read_labels(folder, NAME, 20, 12)["sofa"]
    np.testing.assert_array_equal(halved, square[::2, ::2])
    for name, reason in (("frame_3.png", "has no annotation"), ("frame_4.png", "lists no image")):
        with pytest.raises(InputError, match=rf"all\.json: {reason} of '{name}'"):
            read_labels(folder, name, 40, 24)
    with pytest.raises(InputError, match="of another shape than its photograph"):
        read_labels(folder, NAME, 40, 24, Window.whole(24, 40))


def test_labels_of_coco_beside_those_of_a_frame_are_refused(tmp_path):
    write_coco(tmp_path / "all.json")
    write(tmp_path, thing())
    with pytest.raises(InputError, match=r"all\.json has labels of COCO, and frame_1\.json"):
        labelled_frames(tmp_path)
