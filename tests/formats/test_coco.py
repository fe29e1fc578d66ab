"""COCO files: masks as pycocotools draws them, what is written, and bad files."""

import json

import numpy as np
import pytest
from pycocotools import mask as coco_mask
from pycocotools.coco import COCO
from scipy import ndimage

from slgaussian.errors import InputError
from slgaussian.formats.coco import read_coco
from slgaussian.formats.coco_writer import POLYGON_TOLERANCE, write_coco
from slgaussian.formats.polygons import fill_polygon, trace_polygons
from slgaussian.formats.resampling import Window
from slgaussian.labels import LabelMaps
from slgaussian.scene import Camera, View

HEIGHT, WIDTH = 48, 64
WORDS = {1: "cup", 2: "object 2", 5: "cup"}


def draw_by_pycocotools(polygons, height=HEIGHT, width=WIDTH) -> np.ndarray:
    flat = [polygon.ravel().tolist() for polygon in polygons]
    return coco_mask.decode(coco_mask.merge(coco_mask.frPyObjects(flat, height, width))) > 0


def distance_to_outline(pixels: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distances of pixel centres, bool [H, W], from the outline of a polygon [n, 2]."""
    centres = np.argwhere(pixels)[:, ::-1] + 0.5
    sides = np.roll(points, -1, 0) - points
    along = ((centres[:, None] - points) * sides).sum(-1) / (sides**2).sum(-1)
    nearest = points + along.clip(0, 1)[..., None] * sides
    return np.linalg.norm(nearest - centres[:, None], axis=-1).min(1)


def draw_views() -> tuple[list[View], LabelMaps]:
    """Two views that show the middle of photographs twice as fine, with objects with holes."""
    camera = Camera(np.diag([60, 60, 1.0]), np.eye(4), WIDTH, HEIGHT)
    window = Window(2 * WIDTH + 20, 2 * HEIGHT, 10.0, 0.0, 2.0 * WIDTH + 10, 2.0 * HEIGHT)
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    views = [View(f"images/{n}.jpg", camera, image, window=window) for n in "ab"]
    noise = np.random.default_rng(0).normal(size=(2, HEIGHT, WIDTH))
    smooth = ndimage.gaussian_filter(noise, (0, 3, 3))
    labels = np.select([smooth > 0.05, smooth < -0.05], [1, 2], 0)
    labels[:, 4:20, 6:30], labels[:, 8:12, 10:14] = 5, 0
    return views, LabelMaps(labels.astype(np.int32), np.ones(labels.shape, np.float32))


@pytest.mark.parametrize("whole", [False, True])
def test_fill_polygon_equals_pycocotools_but_for_its_rounding(whole):
    rng = np.random.default_rng(int(whole))
    for corners in range(3, 13):
        points = rng.uniform(-3, WIDTH + 3, (corners, 2))
        points = np.round(points) if whole else points
        ours, theirs = fill_polygon(points, HEIGHT, WIDTH), draw_by_pycocotools([points])
        assert ours.any() and distance_to_outline(ours != theirs, points).max(initial=0) < 0.4


@pytest.mark.parametrize(
    ("tolerance", "overlap"), [(0.0, 1.0), (POLYGON_TOLERANCE, 0.99), (1.0, 0.5)]
)
def test_trace_polygons_keeps_pieces_and_holes_of_a_mask(tolerance, overlap):
    for labels in draw_views()[1].labels:
        for id_ in WORDS:
            mask = labels == id_
            polygons = trace_polygons(mask, tolerance)
            for drawn in (
                np.any([fill_polygon(p, HEIGHT, WIDTH) for p in polygons], axis=0),
                draw_by_pycocotools(polygons),
            ):
                assert (drawn & mask).sum() >= overlap * (drawn | mask).sum()


@pytest.mark.parametrize("polygons", [False, True])
def test_write_coco_is_read_by_pycocotools_with_the_same_masks(tmp_path, polygons):
    views, maps = draw_views()
    write_coco(tmp_path, views, maps, WORDS, polygons)
    theirs, ours = COCO(tmp_path / "annotations.json"), read_coco(tmp_path / "annotations.json")
    assert {c["name"] for c in theirs.loadCats(theirs.getCatIds())} == {"cup", "object 2"}
    assert len(theirs.anns) == 6
    for view, labels in zip(views, maps.labels, strict=True):
        image = ours.find(view.name)
        window = view.visible_window
        spread = window.spread_ids(labels, window.photo_height, window.photo_width)
        for annotation in ours.annotations[image.id]:
            entry = theirs.anns[annotation.id]
            mask = theirs.annToMask(entry) > 0
            drawn = ours.draw(annotation, image)
            expected = spread == annotation.track
            assert theirs.cats[entry["category_id"]]["name"] == WORDS[annotation.track]
            assert entry["iscrowd"] == 0 and entry["attributes"] == {"track_id": annotation.track}
            runs = theirs.annToRLE(entry)
            if polygons:
                for other in (mask, drawn):  # at the pixels of the label map
                    found, given = window.ids(other, HEIGHT, WIDTH), labels == annotation.track
                    assert (found & given).sum() > 0.9 * (found | given).sum()
                assert abs(entry["area"] / coco_mask.area(runs) - 1) < 0.05
                np.testing.assert_allclose(entry["bbox"], coco_mask.toBbox(runs), atol=2)
            else:
                np.testing.assert_array_equal(mask, expected)
                np.testing.assert_array_equal(drawn, expected)
                assert entry["area"] == coco_mask.area(runs)
                assert entry["bbox"] == coco_mask.toBbox(runs).tolist()


def test_spread_ids_is_the_inverse_of_ids():
    _, maps = draw_views()
    for scale, left in ((1.0, 0.0), (1.7, 3.3), (4.0, 10.0)):
        right, bottom = left + scale * WIDTH, scale * HEIGHT
        window = Window(int(right) + 9, int(bottom), left, 0.0, right, bottom)
        spread = window.spread_ids(maps.labels[0], window.photo_height, window.photo_width)
        np.testing.assert_array_equal(window.ids(spread, HEIGHT, WIDTH), maps.labels[0])
        assert not spread[:, : int(left)].any() and not spread[:, int(right) + 1 :].any()


TRIANGLE = [[1, 1, 5, 1, 5, 4]]
GOOD = {
    "images": [{"id": 1, "file_name": "a.jpg", "width": 8, "height": 6}],
    "categories": [{"id": 1, "name": "cup"}],
    "annotations": [
        {"id": 7, "image_id": 1, "category_id": 1, "segmentation": [[1, 1, 5, 1, 5, 4]]}
    ],
}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"category_id": 3}, "annotation 7: its category_id 3 is none of the categories"),
        ({"image_id": 3}, "annotation 7: its image_id 3 is none of the images"),
        ({"segmentation": None}, "segmentation None, expected polygons or run lengths"),
        ({"segmentation": [[1, 1, 5, 1]]}, "expected x0, y0, x1, y1, x2, y2 or more"),
        ({"segmentation": [[1, 1, 5, 1, 5, float("nan")]]}, "expected x0, y0, x1"),
        ({"segmentation": [[1, 1, 50, 1, 5, 4]]}, "spans 1, 1, 50, 4, outside the 8x6 pixels"),
        ({"segmentation": {"size": [8, 6], "counts": [48]}}, r"have size \[8, 6\], expected"),
        ({"segmentation": {"size": [6, 8], "counts": [47]}}, "annotation 7: its counts add up to"),
        ({"segmentation": {"size": [6, 8], "counts": "0o"}}, "annotation 7: its counts end within"),
    ],
)
def test_read_coco_refuses_a_bad_annotation(tmp_path, change, message):
    file = tmp_path / "labels.json"
    file.write_text(json.dumps({**GOOD, "annotations": [{**GOOD["annotations"][0], **change}]}))
    with pytest.raises(InputError, match=message) as caught:
        coco = read_coco(file)
        coco.draw(coco.annotations[1][0], coco.images["a.jpg"])
    assert str(file) in str(caught.value)


@pytest.mark.parametrize("kind", ["images", "categories"])
def test_read_coco_refuses_an_id_that_is_given_twice(tmp_path, kind):
    file = tmp_path / "labels.json"
    file.write_text(json.dumps({**GOOD, kind: GOOD[kind] * 2}))
    with pytest.raises(InputError, match=f"{kind}: id 1 is given twice"):
        read_coco(file)
