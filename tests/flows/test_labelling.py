"""`slgaussian masks`, and fields built from its output."""

import json
from pathlib import Path

import numpy as np
import pytest
from command import ROOM, files_below, room_sample, save_photographs
from PIL import Image

from flows.cli.app import app
from slgaussian.field import SemanticField
from slgaussian.geometry import SeenView
from slgaussian.masks.precomputed import Precomputed, encode_ids, read_ids

PHOTOS = [f"{name}.png" for name in ROOM["context"]]


@pytest.fixture
def words(tmp_path, monkeypatch):
    """Return the words of a command for two photographs, without its output."""
    monkeypatch.chdir(save_photographs(tmp_path))
    return [*PHOTOS, "--cameras", "transforms.json", "--set", "near=0.8", "--set", "far=12"]


def test_masks_that_are_written_are_those_that_a_field_reads(words, tmp_path, slg):
    status, printed, _ = slg("masks", *words, "-o", "ids")
    files = sorted(file.name for file in (tmp_path / "ids").iterdir())
    assert status == 0 and files == ["look.jpg", "masks.json", *PHOTOS]
    maps = np.stack([read_ids(tmp_path / "ids" / name) for name in PHOTOS])
    assert maps.shape == (2, 64, 64) and maps.max() > 2
    assert Image.open(tmp_path / "ids" / PHOTOS[0]).mode.startswith("I;16")
    objects = np.setdiff1d(maps, [0])
    shared = np.intersect1d(*(np.setdiff1d(first, [0]) for first in maps))
    assert f"{len(objects)} objects, {len(shared)} of them in several views" in printed
    assert len(shared)

    # They are what a field is built from without them, and the same ids come back.
    sample = room_sample()
    rerun = Precomputed(folder=tmp_path / "ids")
    for view, ids in zip(sample.context, maps, strict=True):
        np.testing.assert_array_equal(rerun.propagate(SeenView(view)), ids)
    tracker = ["--tracker", "precomputed", "--set", "precomputed.folder=ids"]
    assert slg("field", *words, *tracker, "-o", "given")[0] == 0
    inputs = SemanticField.load("given")
    assert inputs.bank.ids.tolist() == objects.tolist()
    present = np.stack([[(first == i).any() for first in maps] for i in objects])
    np.testing.assert_array_equal(inputs.bank.present, present)

    info = json.loads((tmp_path / "ids" / "masks.json").read_text())
    assert info["views"] == {name: name for name in PHOTOS}
    assert info["settings"]["proposer"] == {"regions": {}}
    assert info["settings"]["votes"] == "views"


def test_masks_replace_masks_and_nothing_else(words, tmp_path, monkeypatch, slg, refusal):
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "letter.txt").write_text("dear")
    error = refusal("masks", *words, "-o", "letters")
    assert "exists and is not a folder of masks" in error
    assert "swiss" in refusal("masks", *words, "--tracker", "swiss", "-o", "ids")
    assert not (tmp_path / "ids").exists()
    for _ in range(2):
        assert slg("masks", *words, "-o", "ids")[0] == 0
    # What fails half way leaves what was there.
    before = files_below(tmp_path / "ids")
    with monkeypatch.context() as patched:
        patched.setattr("slgaussian.benchmark.pictures.encode_jpeg", lambda *a: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            app(["masks", *words, "-o", "ids"], standalone_mode=False)
    assert files_below(tmp_path / "ids") == before
    names = sorted(file.name for file in tmp_path.iterdir())
    assert names == ["ids", "letters", "transforms.json", *PHOTOS]


@pytest.mark.parametrize(("top", "suffix"), [(0, ".png"), (65535, ".png"), (65536, ".npy")])
def test_a_map_of_any_ids_reads_as_it_was_written(tmp_path, top, suffix):
    ids = np.array([[0, 1, 300], [top, 2, 0]], np.int32).clip(0, max(top, 0))
    result, data = encode_ids(ids)
    assert result == suffix
    (tmp_path / f"a{result}").write_bytes(data)
    np.testing.assert_array_equal(read_ids(tmp_path / f"a{result}"), ids)


READERS = {
    "gaussian-grouping": "tracker",
    "coco": "tracker",
    "coco-polygons": "tracker",
    "langsplat": "proposer",
}


@pytest.mark.parametrize("layout", READERS)
def test_masks_in_the_layout_of_another_program_build_the_same_field(words, slg, layout):
    assert slg("masks", *words, "-o", "ids")[0] == 0
    assert slg("masks", *words, "--format", layout, "-o", "other")[0] == 0
    fields = []
    for folder, kind in (("ids", "tracker"), ("other", READERS[layout])):
        read = [f"--{kind}", "precomputed", "--set", f"precomputed.folder={folder}"]
        assert slg("field", *words, *read, "-o", f"field-{folder}")[0] == 0
        fields.append(SemanticField.load(f"field-{folder}"))
    if layout.startswith("coco"):
        annotations = json.loads(Path("other/annotations.json").read_text())["annotations"]
        is_polygon = {isinstance(each["segmentation"], list) for each in annotations}
        assert is_polygon == {layout == "coco-polygons"}
    direct, other = (field.render(field.cameras["view_00.png"]) for field in fields)
    if layout == "coco-polygons":
        assert (direct.ids == other.ids).mean() > 0.98
    else:
        np.testing.assert_array_equal(direct.ids, other.ids)
        hits = [view.query("red chair") for view in (direct, other)]
        np.testing.assert_array_equal(hits[0].relevancy, hits[1].relevancy)


def test_masks_refuses_an_encoder_that_its_format_does_not_use(words, refusal):
    assert "--encoder has no use for --format ids" in refusal("masks", *words, "--encoder", "clip")
