"""Masks of COCO and LangSplat, as the tracker and the proposer `precomputed` read them."""

import json

import numpy as np
import pytest
from drawn_views import SIZE, canvas, view

from slgaussian.errors import InputError
from slgaussian.masks import load_proposer, load_tracker

LARGE, SMALL = (10, 10, 100, 80), (20, 20, 30, 30)
"""Boxes as x, y, width, height; the second is inside the first."""


def annotate(number, box, **more) -> dict:
    x, y, w, h = box
    polygon = [x, y, x + w, y, x + w, y + h, x, y + h]
    return {"id": number, "image_id": 1, "category_id": 1, "segmentation": [polygon], **more}


def write_coco(folder, *annotations) -> None:
    images = [{"id": n, "file_name": f"{n}.png", "width": 160, "height": 120} for n in (1, 2)]
    document = {"images": images, "categories": [{"id": 1, "name": "cup"}]}
    (folder / "labels.json").write_text(json.dumps({**document, "annotations": annotations}))


def draw(*boxes) -> np.ndarray:
    """Draw boxes with ids 1, 2 ..., later ones on top."""
    ids = np.zeros(SIZE, np.int32)
    for number, (x, y, w, h) in enumerate(boxes, start=1):
        ids[y : y + h, x : x + w] = number
    return ids


@pytest.mark.parametrize("place", [".", "labels.json"])
@pytest.mark.parametrize(("first", "ids"), [(0, (6, 1)), (1, (5, 1))])
def test_tracker_reads_track_ids_of_coco_with_the_smaller_object_on_top(
    tmp_path, place, first, ids
):
    small, large = {"track_id": first}, {"attributes": {"track_id": 5}}
    write_coco(tmp_path, annotate(7, SMALL, **small), annotate(8, LARGE, **large))
    tracker = load_tracker("precomputed", folder=tmp_path / place)
    expected = np.array([0, *ids])[draw(LARGE, SMALL)]
    np.testing.assert_array_equal(tracker.propagate(view(canvas(), "x/1.jpg")), expected)
    with pytest.warns(UserWarning, match="is empty"):
        assert not tracker.propagate(view(canvas(), "2.png")).any()
    with pytest.raises(InputError, match=r"lists no image of view '3\.png'"):
        tracker.propagate(view(canvas(), "3.png"))


@pytest.mark.parametrize("track", [None, -1, 1.5, "cup"])
def test_tracker_refuses_coco_without_track_ids(tmp_path, track):
    write_coco(tmp_path, annotate(7, SMALL, attributes={"track_id": track}))
    tracker = load_tracker("precomputed", folder=tmp_path)
    with pytest.raises(InputError, match=r"annotation 7 has the track_id .*--proposer precomputed"):
        tracker.propagate(view(canvas(), "1.png"))


def test_proposer_reads_overlapping_objects_of_coco_without_crowds(tmp_path):
    crowd = annotate(9, LARGE, iscrowd=1)
    write_coco(tmp_path, annotate(7, SMALL), annotate(8, LARGE), crowd)
    with pytest.warns(UserWarning, match="annotation 9 is a crowd"):
        proposals = load_proposer("precomputed", folder=tmp_path).propose(view(canvas(), "1.png"))
    np.testing.assert_array_equal(proposals.masks, [draw(SMALL) > 0, draw(LARGE) > 0])


@pytest.mark.parametrize("dtype", [np.int32, np.float32])  # LangSplat's own program saves floats
def test_proposer_reads_the_segments_of_all_levels_of_langsplat(tmp_path, dtype):
    levels = draw(SMALL) - 1, np.where(draw(LARGE) > 0, 1, -1)
    folder = tmp_path / "language_features"
    folder.mkdir()
    np.save(folder / "1_s.npy", np.array(levels, dtype))
    np.save(folder / "1_f.npy", np.eye(2, 512, dtype=np.float32))
    frame, proposer = view(canvas(), "1.png"), load_proposer("precomputed", folder=tmp_path)
    np.testing.assert_array_equal(proposer.propose(frame).masks, [draw(SMALL) > 0, draw(LARGE) > 0])
    assert not len(proposer.propose(frame, np.ones(SIZE, bool)).masks)
    with pytest.raises(InputError, match="LangSplat's segments are not the same in all views"):
        load_tracker("precomputed", folder=tmp_path).propagate(frame)


@pytest.mark.parametrize(
    "bad", [np.zeros(SIZE, int), np.full((4, 9, 9), -2), np.full((1, 9, 9), 0.5)]
)
def test_proposer_refuses_other_arrays_than_segments(tmp_path, bad):
    np.save(tmp_path / "1_s.npy", bad)
    np.save(tmp_path / "1_f.npy", np.eye(2))
    with pytest.raises(InputError, match=r"1_s\.npy: found .* expected segments \[levels, H, W\]"):
        load_proposer("precomputed", folder=tmp_path).propose(view(canvas(), "1.png"))
