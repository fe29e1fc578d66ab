"""A field of a scene of known geometry: a wall of three colours, and a square in front of it."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import ndimage

from slgaussian.build import build_field
from slgaussian.errors import InputError, SpecError
from slgaussian.field import SemanticField
from slgaussian.formats.ply import save_ply
from slgaussian.scene import Estimated
from tests.square import BLUE, COLOURS, GREEN, RED, YELLOW, camera, label_view, square_field

NEW = camera(0.05)
true_ids, true_depth = label_view(NEW)
INTERIOR = ndimage.maximum_filter(true_ids, 7) == ndimage.minimum_filter(true_ids, 7)
"""Pixels where no border of two objects mixes their light."""


@pytest.fixture(scope="module")
def field() -> SemanticField:
    return square_field("grid")


def test_novel_view_has_true_colours_ids_and_depth(field):
    view = field.render(NEW)
    assert (view.ids == true_ids)[INTERIOR].all()
    colours = np.array([COLOURS[label] for label in true_ids[INTERIOR]])
    assert np.abs(view.rgb[INTERIOR].astype(int) - colours).max() <= 2
    assert np.abs(view.depth - true_depth)[INTERIOR].max() < 1e-3


def test_words_find_their_objects(field):
    view = field.render(NEW)
    for text, label in (("red", RED), ("blue wall", BLUE), ("yellow", YELLOW)):
        hit, truth = view.query(text), true_ids == label
        assert (hit.mask & truth).sum() / (hit.mask | truth).sum() > 0.8
        assert true_ids[hit.point[1], hit.point[0]] == label == hit.objects[0][0]
    segments = view.segment(["blue", "red"])
    for label, word in ((BLUE, 1), (RED, 2)):
        assert (segments == word)[INTERIOR & (true_ids == label)].mean() > 0.97
    words = {item.id: item.words[0][0] for item in field.inventory(["blue", "red"])}
    assert (words[RED], words[BLUE]) == ("red", "blue")


def test_arguments_of_wrong_types_raise_input_error(field, tmp_path):
    view = field.render(NEW)
    for call, message in [
        (lambda: field.render("a.jpg"), "render: expected a Camera.*found a str"),
        (lambda: view.query(["red", "blue"]), "query: expected one text.*found a list"),
        (lambda: field.query("red", threshold=2), "threshold"),
        (lambda: build_field(["a.jpg", "b.jpg"]), "build_field: expected a Sample.*found a list"),
        (lambda: save_ply(str(tmp_path / "x.ply"), field.gaussians), "save_ply: expected Gauss"),
    ]:
        with pytest.raises(InputError, match=message):
            call()


def test_save_keeps_the_estimate_of_cameras(field, tmp_path):
    estimate = Estimated((0.9, 1.2), "EXIF", 0.8)
    cameras = {**field.cameras, "a": replace(field.cameras["a"], estimated=estimate)}
    replace(field, cameras=cameras).save(tmp_path / "field")
    restored = SemanticField.load(tmp_path / "field")
    assert [restored.cameras[name].estimated for name in "ab"] == [estimate, None]
    file = tmp_path / "field/field.json"
    content = json.loads(file.read_text())
    assert "estimated" not in content["cameras"]["b"]
    content["cameras"]["a"]["estimated"]["confidence"] = 7
    file.write_text(json.dumps(content))
    with pytest.raises(SpecError, match=r"damaged .*estimated"):
        SemanticField.load(tmp_path / "field")


def test_save_writes_reproducible_bytes(field, tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    for folder in (first, second, second):
        field.save(folder)
    files = {file.name: file.read_bytes() for file in first.iterdir()}
    assert files == {file.name: file.read_bytes() for file in second.iterdir()}
    content = json.loads(files["field.json"])
    assert content["format"] == 1 and content["made_by"].startswith("slgaussian ")
    assert content["settings"] == field.settings and list(content["cameras"]) == ["a", "b"]
    assert {*content["files"], "field.json"} == set(files)


@pytest.mark.parametrize("codes", ["grid", "separated"])
def test_saved_field_renders_and_answers_the_same(codes, tmp_path):
    original = square_field(codes)
    original.save(tmp_path / "field")
    restored = SemanticField.load(tmp_path / "field")
    view, restored_view = original.render(NEW), restored.render(NEW)
    assert view.confidence.dtype == np.float32
    for name in ("rgb", "ids", "confidence", "alpha", "depth"):
        np.testing.assert_array_equal(getattr(view, name), getattr(restored_view, name))
    assert (view.ids == true_ids)[INTERIOR].all()
    assert view.confidence[INTERIOR].min() > 0.9 and view.confidence[~INTERIOR].min() < 0.5
    np.testing.assert_array_equal(original.labels(), restored.labels())
    assert set(np.unique(original.labels())) == {RED, GREEN, BLUE, YELLOW}
    table = restored.contents()["objects"]
    assert table.column("id").to_pylist() == [RED, GREEN, BLUE, YELLOW]
    np.testing.assert_array_equal(table.column("code_b"), original.bank.codes[:, 2])
    assert sum(table.column("gaussians").to_pylist()) == len(original.gaussians)
    assert view.query("red").objects[0][0] == RED


def test_load_raises_spec_error_for_features_of_another_width(field, tmp_path):
    features = torch.zeros(len(field.gaussians), 7)
    replace(field, gaussians=replace(field.gaussians, features=features)).save(tmp_path / "field")
    with pytest.raises(SpecError, match=r"gaussians\.npz: .*features"):
        SemanticField.load(tmp_path / "field")


def test_save_does_not_overwrite_other_folders(field, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    for folder, message in (
        (tmp_path, "is not a field"),
        (tmp_path / "notes.txt/field", "cannot be written"),
    ):
        with pytest.raises(InputError, match=message):
            field.save(folder)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize(
    "name", ["gaussians.npz", "bank.npz", "field.json", "words.npz", "edits.npz"]
)
def test_load_raises_spec_error_with_the_name_of_a_damaged_file(field, tmp_path, name):
    field.teach("zorp", RED).without([BLUE]).save(tmp_path / "field")
    file = tmp_path / "field" / name
    data = file.read_bytes()
    for content in (data[: len(data) // 2], data[:-30], None):
        file.unlink() if content is None else file.write_bytes(content)
        if content is None and name in ("words.npz", "edits.npz"):
            continue  # a field without edits has neither
        with pytest.raises(SpecError, match=name.replace(".", r"\.")):
            SemanticField.load(tmp_path / "field")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cameras": None}, "damaged"),
        ({"places": {"model": 3}}, "damaged .a place is not text"),
        ({"files": {"gaussians.npz": "../../etc"}}, "damaged"),
        ({"format": None}, "format: found none.*expected 1; build the field again"),
        ({"format": 9, "made_by": "slgaussian 9"}, "format: found 9, made by slgaussian 9, expect"),
    ],
)
def test_load_raises_spec_error_for_an_invalid_description(field, tmp_path, change, message):
    field.save(tmp_path / "field")
    file = tmp_path / "field" / "field.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | change))
    with pytest.raises(SpecError, match=rf"field\.json: {message}"):
        SemanticField.load(tmp_path / "field")


def test_load_raises_spec_error_for_a_file_of_another_field(field, tmp_path):
    field.save(tmp_path / "field")
    moved = replace(field.gaussians, means=field.gaussians.means + 1)
    replace(field, gaussians=moved).save(tmp_path / "moved")
    shutil.copy(tmp_path / "moved" / "gaussians.npz", tmp_path / "field")
    with pytest.raises(SpecError, match=r"gaussians\.npz: digest: .*another field"):
        SemanticField.load(tmp_path / "field")
